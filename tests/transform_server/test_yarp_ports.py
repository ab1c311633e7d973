"""When the stream of transforms is sent, and in which form."""

from __future__ import annotations

import time
from typing import Any

import pytest

from bridge.transform_server.yarp_ports import FrameStream
from yarp_compat.dev.frametransform import AllTransforms, FrameTransform
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.profile import Profile

FRAMES = [FrameTransform("map", "base", 1.5, 0, 1.0)]


class Port:
    """A port that records written messages."""

    def __init__(self) -> None:
        self.has_readers = True
        self.written: list[Any] = []

    def write(self, content: Any) -> None:
        self.written.append(content)


def stream(port: Port) -> FrameStream:
    generations = {Profile.YARP3: Generation.YARP_3_6, Profile.YARP4: Generation.YARP_4}
    return FrameStream(port, lambda: FRAMES, generations.__getitem__, 0.01)  # type: ignore[arg-type]


def test_a_set_frame_is_sent_within_one_period(monkeypatch: pytest.MonkeyPatch) -> None:
    port, now = Port(), [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    frame_stream = stream(port)
    sent = []
    for later, action in (
        (0, frame_stream.tick), (1, frame_stream.changed), (10, frame_stream.tick), (17, frame_stream.changed),
        (20, frame_stream.tick), (27, frame_stream.changed), (30, frame_stream.tick),
        (40, frame_stream.tick), (50, frame_stream.tick),
    ):  # fmt: skip
        now[0] = 100.0 + later / 1000
        before = len(port.written)
        action()
        sent += [later] if len(port.written) > before else []
    assert sent == [0, 10, 17, 27, 40, 50]
    port.has_readers = False
    now[0] += 1
    frame_stream.tick()
    assert len(port.written) == 6, "nothing is written without a reader"


def test_each_dialect_gets_the_outcome_in_its_releases_form() -> None:
    port = Port()
    stream(port).tick()
    for profile, outcome in (
        (Profile.YARP3, b"\x09\0\0\0ok\0\0"),
        (Profile.YARP4, b"\0\1\0\0\1\0\0\0\x09\0\0\0ok\0\0"),
    ):
        payload = b"".join(port.written[0].to_wire(profile))
        assert payload[8:].startswith(outcome)
        assert AllTransforms.from_bytes(payload, profile).transforms_list == FRAMES
