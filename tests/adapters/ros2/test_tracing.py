"""LTTng's files in a full /dev/shm are replaced by links."""

from __future__ import annotations

import atexit
import os
from pathlib import Path

import pytest

from bridge.adapters.ros2 import tracing
from bridge.adapters.ros2.tracing import allow_tracing_if_room

NAME = "lttng-ust-wait-6"


def names(folder: Path) -> set[str]:
    """Return the links in a folder."""
    return {file.name for file in folder.iterdir() if file.is_symlink()}


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "_is_full", lambda _folder: True)
    monkeypatch.setattr(atexit, "register", lambda *_: None)


@pytest.mark.usefixtures("full")
def test_links_replace_files_without_a_page(tmp_path: Path) -> None:
    (tmp_path / NAME).touch()
    os.truncate(tmp_path / NAME, 4096)
    (tmp_path / f"{NAME}-{os.getuid()}").write_bytes(bytes(4096))
    os.sync()
    allow_tracing_if_room(tmp_path)
    assert {NAME, "lttng-ust-wait-8", f"lttng-ust-wait-8-{os.getuid()}"} <= names(tmp_path)
    assert f"{NAME}-{os.getuid()}" not in names(tmp_path)
    with pytest.raises(OSError, match="Too many levels"):
        os.open(tmp_path / NAME, os.O_RDONLY | os.O_NOFOLLOW)


def test_links_of_a_killed_worker_are_removed_when_there_is_space(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(tracing, "_is_full", lambda _folder: True)
        patch.setattr(atexit, "register", lambda *_: None)
        allow_tracing_if_room(tmp_path)
    assert names(tmp_path)
    (tmp_path / "lttng-ust-wait-other").symlink_to("elsewhere")
    allow_tracing_if_room(tmp_path)
    assert names(tmp_path) == {"lttng-ust-wait-other"}


@pytest.mark.usefixtures("full")
def test_a_file_that_cannot_be_removed_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / NAME).touch()

    def refuse(_file: Path, missing_ok: bool = False) -> None:
        del missing_ok
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(RuntimeError, match=rf"{NAME} cannot be removed \(Operation not permitted\).*make room there"):
        allow_tracing_if_room(tmp_path)
