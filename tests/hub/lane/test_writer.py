"""The writing end of a session's lanes outlives errors."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from bridge.hub.lane import folder
from bridge.hub.lane.blocks import Blocks
from bridge.hub.lane.outlet import ReaderLink
from bridge.hub.lane.wire import FENCE, HEAD, ON, TOKEN
from bridge.hub.lane.writer import LaneWriter
from tests.support.no_threads import no_threads

ZID = "abcd"
RECORD = 1000


def test_an_error_disconnects_only_one_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    errors, read = [RuntimeError("can't start new thread")], LaneWriter._read

    def fail_once(writer: LaneWriter, number: int, link: ReaderLink) -> None:
        if errors:
            raise errors.pop()
        read(writer, number, link)

    monkeypatch.setattr(LaneWriter, "_read", fail_once)
    with contextlib.closing(LaneWriter(tmp_path, ZID, Blocks(lambda *_: None), lambda *_: None)):
        assert _replies(tmp_path) == b"", "it is disconnected"
        assert HEAD.unpack_from(_replies(tmp_path)) == (FENCE, 1)


def test_readers_connect_while_the_system_is_out_of_threads(tmp_path: Path) -> None:
    with (
        contextlib.closing(LaneWriter(tmp_path, ZID, Blocks(lambda *_: None), lambda *_: None)),
        no_threads("hub-lane"),
    ):
        assert HEAD.unpack_from(_replies(tmp_path)) == (FENCE, 1)


def _replies(path: Path) -> bytes:
    """Connect a reader, and return the writer's first record, b"" if it disconnects the reader."""
    with folder.connect(path, ZID) as reader:
        reader.settimeout(40)
        reader.send(HEAD.pack(ON, 1) + b"key")
        with contextlib.suppress(OSError):
            reader.send(HEAD.pack(FENCE, 1) + TOKEN.pack(7))
        try:
            return reader.recv(RECORD)
        except ConnectionResetError:
            return b""
