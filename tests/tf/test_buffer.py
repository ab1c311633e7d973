"""Features of the buffer beyond tf2, and properties that tf2's results do not show."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from bridge.tf import frames as frames_module
from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import (
    ConnectivityError,
    ExtrapolationError,
    FrameRefusal,
    InvalidArgumentError,
    LookupError_,
)
from bridge.tf.history import LARGEST
from tests.support.wait import until

S = 1_000_000_000
START = 1_790_000_000 * S
UNIT = (0.0, 0.0, 0.0, 1.0)


def about_z(angle: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)


def moving(buffer: TransformBuffer, parent: str, child: str, seconds: float = 1.0, rate: int = 100) -> None:
    """Insert a motion of 1 m/s along x and 0.5 rad/s about z."""
    for n in range(round(seconds * rate) + 1):
        at = n / rate
        assert (
            buffer.set_transform(parent, child, START + n * S // rate, (at, 0, 0), about_z(0.5 * at), "mover") is None
        )


@pytest.fixture
def buffer() -> TransformBuffer:
    return TransformBuffer()


def test_extrapolation_needs_a_request_and_is_bounded(buffer: TransformBuffer) -> None:
    moving(buffer, "odom", "base")
    late, early = START + S + S // 5, START - S // 5
    for stamp, direction in ((late, "future"), (early, "past")):
        with pytest.raises(ExtrapolationError, match=f"0.200000000s into the {direction}"):
            buffer.lookup_transform("odom", "base", stamp)
        with pytest.raises(ExtrapolationError):
            buffer.lookup_transform("odom", "base", stamp, extrapolate=0.19)
        transform = buffer.lookup_transform("odom", "base", stamp, extrapolate=0.2)
        at = (stamp - START) / S
        assert transform.stamp == stamp
        assert transform.translation == pytest.approx((at, 0, 0))
        assert transform.rotation == pytest.approx(about_z(0.5 * at))


def test_extrapolation_uses_the_motion_over_an_equal_time(buffer: TransformBuffer) -> None:
    moving(buffer, "odom", "base")
    jitter = START + S + S // 1000
    buffer.set_transform("odom", "base", jitter, (1.011, 0, 0), about_z(0.5))  # 1 cm off, 1 ms later
    transform = buffer.lookup_transform("odom", "base", jitter + S // 2, extrapolate=1.0)
    assert transform.translation[0] == pytest.approx(1.5, abs=0.03)


def test_a_single_sample_is_valid_only_at_its_time(buffer: TransformBuffer) -> None:
    buffer.set_transform("odom", "base", START, (1, 2, 3), UNIT)
    with pytest.raises(ExtrapolationError, match="only time"):
        buffer.lookup_transform("odom", "base", START + 1, extrapolate=1.0)


def test_only_the_last_parent_is_extrapolated(buffer: TransformBuffer) -> None:
    moving(buffer, "odom", "base")
    buffer.set_transform("map", "base", START + 2 * S, (9, 0, 0), UNIT)
    transform = buffer.lookup_transform("map", "base", START + 2 * S + S // 10, extrapolate=0.5)
    assert transform.translation == (9, 0, 0)


def test_stamps_are_compared_with_the_clock() -> None:
    now = START
    buffer = TransformBuffer(max_future=2.0, now=lambda: now)

    def refusal(stamp: int, **more: bool) -> FrameRefusal | None:
        return buffer.set_transform("map", "odom", stamp, (0, 0, 0), UNIT, "amcl", **more)

    assert refusal(now - 60 * S) is None
    assert refusal(now + 2 * S) is None
    assert refusal(now + 2 * S + 1) is FrameRefusal.FUTURE
    assert refusal(now + 3600 * S) is FrameRefusal.FUTURE
    assert refusal(17 * S) is FrameRefusal.TIME_SCALE  # a stamp of a simulation
    assert refusal(0) is FrameRefusal.TIME_SCALE
    assert refusal(-1) is FrameRefusal.INVALID_STAMP
    assert refusal(1 << 70) is FrameRefusal.INVALID_STAMP
    assert (
        refusal(1 << 61, static=True) is FrameRefusal.TIME_SCALE
    )  # the frame has a history, which a static transform would end
    assert buffer.set_transform("base", "laser", 0, (0, 0, 0), UNIT, static=True) is None
    assert buffer.refused == {
        FrameRefusal.FUTURE: 2,
        FrameRefusal.TIME_SCALE: 3,
        FrameRefusal.INVALID_STAMP: 2,
    }
    assert "amcl" in buffer.last_refused[FrameRefusal.TIME_SCALE]
    assert "use_sim_time" in buffer.last_refused[FrameRefusal.TIME_SCALE]
    assert buffer.lookup_transform("map", "odom").stamp == now + 2 * S
    now = 5 * S  # a buffer on simulated time receives a stamp of the system clock
    assert refusal(START) is FrameRefusal.TIME_SCALE


def test_each_kind_of_refusal_is_logged_once(buffer: TransformBuffer, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "bridge.tf.intake"):
        for _ in range(5):
            buffer.set_transform("a", "b", START, (math.nan, 0, 0), UNIT, "me")
        buffer.set_transform("a", "a", START, (0, 0, 0), UNIT, "me")
    messages = [record.getMessage() for record in caplog.records if record.name == "bridge.tf.intake"]
    assert [message.split(":")[0] for message in messages] == ["TF_NAN_INPUT", "TF_SELF_TRANSFORM"]
    assert buffer.refused == {FrameRefusal.NAN_INPUT: 5, FrameRefusal.SELF_TRANSFORM: 1}
    assert buffer.can_transform("a", "b") == (
        False,
        '"a" passed to lookupTransform argument target_frame does not exist. ',
    )


@pytest.mark.parametrize(
    ("stamp", "moved", "turned"),
    [(1.5, (0, 0, 0), UNIT), (START, (0, 0), UNIT), (START, (0, 0, 0), (0, 0, 1)), (START, ("x", 0, 0), UNIT)],
)
def test_arguments_that_are_not_numbers_raise(buffer: TransformBuffer, stamp: int, moved: tuple, turned: tuple) -> None:
    with pytest.raises((TypeError, ValueError)):
        buffer.set_transform("a", "b", stamp, moved, turned)
    assert buffer.frames() == []
    buffer.set_transform("a", "b", np.int64(START), np.ones(3), np.array(UNIT))
    assert buffer.lookup_transform("a", "b").translation == (1, 1, 1)


def test_the_newest_of_two_parents_wins_and_both_are_reported(buffer: TransformBuffer) -> None:
    for n in range(5):
        at = START + n * S // 10
        buffer.set_transform("odom", "base", at, (1, 0, 0), UNIT, "wheels")
        buffer.set_transform("/map", "/base", at + 1, (2, 0, 0), UNIT, "gps")
    assert buffer.lookup_transform("map", "base").translation == (2, 0, 0)
    with pytest.raises(ConnectivityError, match="two or more unconnected trees"):
        buffer.lookup_transform("odom", "base")
    (conflict,) = buffer.conflicts()
    assert conflict.name == "base"
    assert conflict.parent == "map"
    assert {(s.parent, s.authority, s.stamp) for s in conflict.sources} == {
        ("odom", "wheels", at),
        ("map", "gps", at + 1),
    }
    assert "wheels under odom" in buffer.tree()
    assert '"odom" -> "base"[style=dashed]' in buffer.dot()
    buffer.set_transform("map", "base", at + 11 * S, (2, 0, 0), UNIT, "gps")
    assert not buffer.conflicts(), "wheels has not published within the history"


def test_a_lookup_in_a_loop_fails(buffer: TransformBuffer) -> None:
    for parent, child in (("a", "b"), ("b", "c"), ("c", "a"), ("a", "d"), ("x", "elsewhere")):
        assert buffer.set_transform(parent, child, START, (1, 0, 0), UNIT) is None
    for stamp in (0, START):
        with pytest.raises(LookupError_, match="contains a loop"):
            buffer.lookup_transform("elsewhere", "d", stamp)
    assert buffer.loops == 2
    assert "loop, through a:" in buffer.tree()
    assert len(buffer.tree().splitlines()) == 7  # x, elsewhere, the line about the loop, the loop's a, b and c, and d


def test_names_ignore_leading_slashes(buffer: TransformBuffer) -> None:
    assert buffer.set_transform("/map", "/odom", START, (1, 0, 0), UNIT) is None
    assert buffer.lookup_transform("map", "/odom").frame_id == "map"
    assert buffer.set_transform("map", "/", START, (1, 0, 0), UNIT) is FrameRefusal.NO_CHILD_FRAME_ID
    assert buffer.set_transform("/map", "map", START, (1, 0, 0), UNIT) is FrameRefusal.SELF_TRANSFORM
    with pytest.raises(InvalidArgumentError, match="cannot be empty"):
        buffer.lookup_transform("map", "", timeout=30)
    assert buffer.lookup_transform_full("map", 0, "odom", START, "map").frame_id == "map"
    with pytest.raises(LookupError_, match="fixed_frame"):
        buffer.lookup_transform_full("map", 0, "odom", START, "nowhere")


@pytest.fixture
def lookup_threads() -> Iterator[list[threading.Thread]]:
    threads: list[threading.Thread] = []
    yield threads
    for thread in threads:
        thread.join(30)


def test_a_waiting_lookup_returns_when_the_transform_arrives(
    buffer: TransformBuffer, lookup_threads: list[threading.Thread]
) -> None:
    answers: list[object] = []

    def look_up() -> None:
        answers.append(buffer.lookup_transform("map", "base", START + S // 2, timeout=40))

    lookup_threads.append(threading.Thread(target=look_up))
    lookup_threads[0].start()
    until(lambda: buffer.waiting == 1, "the lookup waits", 30)
    buffer.set_transform("map", "odom", START, (1, 0, 0), UNIT, static=True)
    assert not answers
    moving(buffer, "odom", "base")
    until(lambda: answers, "the lookup returns long before its deadline")
    assert answers[0].translation == pytest.approx((1.5, 0, 0))  # type: ignore[attr-defined]


def test_a_wait_ends_at_its_deadline_with_the_reason(buffer: TransformBuffer) -> None:
    moving(buffer, "odom", "base")
    start = time.monotonic()
    possible, reason = buffer.can_transform("odom", "base", START + 9 * S, timeout=0.2)
    assert not possible
    assert "into the future" in reason
    assert time.monotonic() - start >= 0.2


def test_lookup_many_equals_single_lookups(buffer: TransformBuffer) -> None:
    moving(buffer, "map", "odom", 1.0)
    moving(buffer, "odom", "base", 1.0)
    buffer.set_transform("base", "laser", 0, (0.2, 0, 0.1), UNIT, static=True)
    stamps = START + np.linspace(-S // 10, 11 * S // 10, 97).astype(np.int64)
    poses = buffer.lookup_many("map", "laser", stamps)
    full = buffer.lookup_many("base", "laser", stamps, fixed_frame="map", target_stamp=START + S)
    assert 0 < poses.known.sum() < len(stamps)
    for n, stamp in enumerate(stamps.tolist()):
        assert poses.known[n] == full.known[n] == (0 <= stamp - START <= S)
        if not poses.known[n]:
            assert np.isnan(poses.translations[n]).all()
            assert np.isnan(full.rotations[n]).all()
            continue
        single = buffer.lookup_transform("map", "laser", stamp)
        assert (*poses.translations[n], *poses.rotations[n]) == (*single.translation, *single.rotation)
        advanced = buffer.lookup_transform_full("base", START + S, "laser", stamp, "map")
        assert (*full.translations[n], *full.rotations[n]) == (*advanced.translation, *advanced.rotation)
    assert buffer.lookup_many("map", "laser", stamps, extrapolate=0.1).known.all()
    assert buffer.lookup_many("map", "map", [START, 0]).rotations.tolist() == [list(UNIT)] * 2
    assert buffer.lookup_many("map", "laser", [0]).stamps.tolist() == [START + S]
    with pytest.raises(LookupError_):
        buffer.lookup_many("map", "nowhere", stamps)


def test_clear_keeps_static_frames(buffer: TransformBuffer) -> None:
    moving(buffer, "odom", "base")
    buffer.set_transform("base", "laser", 0, (0, 0, 1), UNIT, "urdf", static=True)
    assert buffer.set_transform("odom", "base", 5 * S, (0, 0, 0), UNIT) is FrameRefusal.OLD_DATA
    buffer.clear()
    assert not buffer.can_transform("odom", "base")[0]
    assert buffer.lookup_transform("base", "laser", 7 * S).translation == (0, 0, 1)
    assert buffer.set_transform("odom", "base", 5 * S, (3, 0, 0), UNIT) is None
    assert buffer.lookup_transform("odom", "laser").translation == (3, 0, 1)
    assert [info.name for info in buffer.frames()] == ["base", "laser"]


def test_a_removed_frame_may_return_with_another_kind(buffer: TransformBuffer) -> None:
    buffer.set_transform("a", "b", 0, (1, 0, 0), UNIT, static=True)
    assert buffer.remove("/b")
    assert not buffer.remove("b")
    assert not buffer.can_transform("a", "b")[0]
    assert buffer.frames() == []
    moving(buffer, "a", "b")
    assert buffer.lookup_transform("a", "b", START + S // 2).translation == pytest.approx((0.5, 0, 0))


def test_complete_histories_of_many_frames_are_stored(buffer: TransformBuffer) -> None:
    for n in range(150):
        for k in range(200):
            buffer.set_transform("world", f"f{k}", START + n * S // 10, (n, k, 0), UNIT)
    for k in range(200):
        poses = buffer.lookup_many("world", f"f{k}", START + np.arange(150) * S // 10)
        # from 10 s before the newest stamp up to that stamp
        assert poses.known.tolist() == [False] * 49 + [True] * 101
        assert (poses.translations[49:] == [(n, k, 0) for n in range(49, 150)]).all()


def test_a_known_frame_may_get_a_new_parent_with_any_number(buffer: TransformBuffer) -> None:
    for n in range(300):
        buffer.set_transform(f"new{n}", "base", START + n, (n, 0, 0), UNIT)
        assert buffer.lookup_transform(f"new{n}", "base").translation == (n, 0, 0)


def test_a_fast_frame_uses_bounded_memory(buffer: TransformBuffer) -> None:
    for n in range(LARGEST + 100):
        buffer.set_transform("a", "b", START + 1000 * n, (n, 0, 0), UNIT)
    (info,) = buffer.frames()
    assert info.samples == LARGEST
    assert info.oldest == START + 100_000
    assert buffer.lookup_transform("a", "b", info.oldest + 500).translation == pytest.approx((100.5, 0, 0))


def test_generated_names_use_bounded_memory(buffer: TransformBuffer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames_module, "MAX_FRAMES", 10)
    refusals = [buffer.set_transform("a", f"b{n}", START, (0, 0, 0), UNIT) for n in range(20)]
    assert refusals.count(FrameRefusal.TOO_MANY_FRAMES) > 5
    assert buffer.set_transform("a", "b0", START + 1, (0, 0, 0), UNIT) is None


def test_frames_report_rate_age_and_authority(buffer: TransformBuffer) -> None:
    moving(buffer, "odom", "base", 2.0, rate=20)
    buffer.set_transform("base", "laser", 0, (0, 0, 1), UNIT, "urdf", static=True)
    base, laser = buffer.frames()
    assert (base.parent, base.authority, base.static, base.newest, base.samples) == (
        "odom",
        "mover",
        False,
        START + 2 * S,
        41,
    )
    assert base.rate == pytest.approx(20)
    assert (laser.parent, laser.authority, laser.static, laser.newest) == ("base", "urdf", True, 0)
    assert buffer.tree().splitlines() == [
        "odom",
        "  base  (20.0 Hz, newest 1790000002.000 s, mover)",
        "    laser  (static, urdf)",
    ]
    assert buffer.dot().startswith("digraph G {\n")
    assert '"base" -> "laser"[label="authority: urdf\\nstatic"];' in buffer.dot()


def test_lookups_are_safe_during_insertions(buffer: TransformBuffer, lookup_threads: list[threading.Thread]) -> None:
    buffer.set_transform("a", "b0", START, (0, 0, 0), UNIT)
    wrong: list[object] = []
    started = threading.Event()

    def look_up() -> None:
        while not started.is_set():
            transform = buffer.lookup_transform("a", "b0")
            if transform.translation[0] != (transform.stamp - START) / 1000:
                wrong.append(transform)

    for _ in range(2):
        lookup_threads.append(threading.Thread(target=look_up))
        lookup_threads[-1].start()
    for n in range(1, 3000):  # rings and arrays grow during this
        buffer.set_transform("a", f"b{n % 40}", START + 1000 * n, (n, 0, 0), UNIT)
    started.set()
    for thread in lookup_threads:
        thread.join(30)
    assert not wrong
