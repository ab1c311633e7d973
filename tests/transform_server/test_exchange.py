"""YARP programs' frames on the hub and vice versa: expiry, stamps, deletion, names, loops, two clocks."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest

from bridge.clock import RunClock
from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import FrameRefusal
from bridge.tf.stamped import Stamped, read, write
from bridge.transform_server.exchange import Exchange
from bridge.transform_server.view import View, YarpClock
from bridge.transform_server.yarp_ports import Getter, Setter
from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.returnvalue import CallFailed

UNIT = (0.0, 0.0, 0.0, 1.0)


class StoppedClock:
    """The system's clock, as `time.time` and `time.time_ns`; only the test advances it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.system = 1_795_000_000.0
        monkeypatch.setattr(time, "time", lambda: self.system)
        monkeypatch.setattr(time, "time_ns", lambda: round(self.system * 1e9))


class ExchangeRig:
    """An exchange, and the messages that it published."""

    def __init__(self, run: RunClock, *, on_run_clock: bool = True) -> None:
        self.run, self.clock = run, YarpClock(run, on_run_clock=on_run_clock)
        self.view = View(self.clock.now, 0.2, 1.0)
        self.buffer = TransformBuffer(now=run.now_ns)
        self.message: list[Stamped] = []
        self.static: list[list[Stamped]] = []
        self.exchange = Exchange(
            self.buffer,
            self.view,
            self.clock,
            lambda cdr: self.message.extend(read(cdr)),
            lambda c: self.static.append(read(c)),
        )

    def set(self, *transforms: FrameTransform) -> FrameRefusal | None:
        return self.exchange.set(transforms)

    def receive(
        self, parent: str, child: str, stamp: int | None = None, *, static: bool = False, x: float = 0.0
    ) -> None:
        stamp = self.run.now_ns() if stamp is None else stamp
        self.exchange.receive(write([Stamped(parent, child, stamp, (x, 0.0, 0.0), UNIT)]), "/node", static=static)

    def seen(self) -> dict[str, FrameTransform]:
        return {transform.dst_frame_id: transform for transform in self.exchange.frames()}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> StoppedClock:
    return StoppedClock(monkeypatch)


@pytest.fixture
def rig(clock: StoppedClock) -> ExchangeRig:
    return ExchangeRig(RunClock())


def frame(parent: str, child: str, stamp: float, **values: Any) -> FrameTransform:
    return FrameTransform(parent, child, stamp, **values)


def test_a_yarp_programs_frame_is_published_once_and_expires(rig: ExchangeRig, clock: StoppedClock) -> None:
    given = frame("map", "base", clock.system, tX=1.0, tY=2.0, tZ=3.0, qX=0.6, qY=0.0, qZ=0.0, qW=0.8)
    assert rig.set(given) is None
    assert rig.message == [Stamped("map", "base", 1_795_000_000_000_000_000, (1.0, 2.0, 3.0), (0.6, 0.0, 0.0, 0.8))]
    clock.system += 0.19
    assert rig.seen() == {"base": given}
    clock.system += 0.02
    assert rig.seen() == {}
    assert len(rig.message) == 1
    assert rig.buffer.lookup_transform("map", "base").translation == (1.0, 2.0, 3.0)


def test_an_expired_transform_is_ignored(rig: ExchangeRig, clock: StoppedClock) -> None:
    assert rig.set(frame("map", "base", clock.system - 0.3), frame("map", "other", clock.system)) is None
    assert [t.child_frame_id for t in rig.message] == ["other"]
    assert rig.exchange.ignored["expired"] == 1


def test_frames_of_the_hub_get_the_current_time_and_are_never_published(rig: ExchangeRig, clock: StoppedClock) -> None:
    rig.receive("odom", "base", rig.run.now_ns() - 100_000_000, x=4.0)
    clock.system += 0.9
    shown = rig.seen()["base"]
    assert (shown.src_frame_id, shown.tX, shown.timestamp, shown.isStatic) == ("odom", 4.0, clock.system, 0)
    clock.system += 0.5
    assert rig.seen() == {}
    assert not rig.message
    assert not rig.static


def test_a_frame_at_one_hertz_is_shown_continuously(rig: ExchangeRig, clock: StoppedClock) -> None:
    for tick in range(400):
        if tick in (0, 100, 203, 300):  # one tick is late
            rig.receive("odom", "base")
        assert "base" in rig.seen(), tick
        clock.system += 0.01


def test_a_repeated_transform_stays_valid(rig: ExchangeRig, clock: StoppedClock) -> None:
    stamp = rig.run.now_ns()
    for _ in range(5):
        rig.receive("odom", "base", stamp)
        clock.system += 0.5
        assert "base" in rig.seen()


def test_the_stream_contains_every_change(rig: ExchangeRig, clock: StoppedClock) -> None:
    changes: list[None] = []
    rpc = Setter(rig.exchange, lambda: changes.append(None))
    for call in (
        lambda: rpc.setTransformRPC(frame("map", "base", clock.system)),
        lambda: rpc.deleteTransformRPC("map", "base"),
        rpc.clearAllRPC,
    ):
        before = len(changes)
        assert call()
        assert len(changes) == before + 1


def test_static_frames_stay_and_are_published_together(rig: ExchangeRig, clock: StoppedClock) -> None:
    rig.receive("base", "lidar", 0, static=True)
    rig.set(frame("base", "camera", clock.system, isStatic=1, tX=1.0))
    rig.set(frame("base", "arm", clock.system, isStatic=1))
    assert [[t.child_frame_id for t in message] for message in rig.static] == [["camera"], ["camera", "arm"]]
    clock.system += 1000
    seen = rig.seen()
    assert sorted(seen) == ["arm", "camera", "lidar"]
    assert seen["lidar"].isStatic == 1
    # as in YARP, the frame is static until it is deleted
    assert rig.set(frame("base", "camera", clock.system, tX=5.0)) is None
    assert rig.seen()["camera"].tX == 1.0
    assert rig.exchange.ignored["static"] == 1
    assert not rig.message


def test_a_frame_that_expired_may_become_static(rig: ExchangeRig, clock: StoppedClock) -> None:
    rig.set(frame("map", "base", clock.system))
    clock.system += 1
    assert rig.set(frame("map", "base", clock.system, isStatic=1, tX=2.0)) is None
    assert rig.buffer.lookup_transform("map", "base", 1).translation == (2.0, 0.0, 0.0)


def test_frames_are_deleted_in_either_order_and_by_wildcard(rig: ExchangeRig, clock: StoppedClock) -> None:
    def all_set() -> None:
        pairs = (("map", "a"), ("map", "b"), ("b", "c"))
        assert rig.set(*(frame(p, c, clock.system, isStatic=1) for p, c in pairs)) is None

    rpc = Setter(rig.exchange)
    for source, target, left in (
        ("map", "a", "bc"),
        ("a", "map", "bc"),
        ("map", "*", "c"),
        ("*", "c", "ab"),
        ("*", "*", ""),
    ):
        all_set()
        assert rpc.deleteTransformRPC(source, target)
        assert sorted(rig.seen()) == sorted(left)
        assert [t.child_frame_id for t in rig.static[-1]] == list(left)
        assert not rig.buffer.can_transform("map", "a")[0] or "a" in left
    all_set()
    assert rpc.clearAllRPC()
    assert not rig.seen()
    assert rpc.deleteTransformRPC("*", "x")
    with pytest.raises(CallFailed):
        rpc.deleteTransformRPC("map", "a")
    all_set()  # deleted frames can be set again
    assert len(rig.seen()) == 3


def test_yarp_programs_cannot_delete_frames_of_other_sides(rig: ExchangeRig, caplog: pytest.LogCaptureFixture) -> None:
    rig.receive("base", "lidar", 0, static=True)
    rpc = Setter(rig.exchange)
    with pytest.raises(CallFailed):
        rpc.deleteTransformRPC("base", "lidar")
    assert "another side publishes it" in caplog.text
    caplog.clear()
    rpc.clearAllRPC()
    assert list(rig.seen()) == ["lidar"]
    assert not [record for record in caplog.records if record.name == "bridge.transform_server.exchange"]


def test_names_keep_yarps_spelling_and_have_no_slash_on_the_hub(rig: ExchangeRig, clock: StoppedClock) -> None:
    rig.receive("map", "odom")
    assert rig.set(frame("/odom", "/base", clock.system)) is None
    assert [(t.frame_id, t.child_frame_id) for t in rig.message] == [("odom", "base")]
    seen = rig.seen()
    assert (seen["/odom"].src_frame_id, seen["/base"].src_frame_id) == ("map", "/odom")
    rig.receive("/base", "laser")
    assert rig.seen()["laser"].src_frame_id == "/base"


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ({"tX": math.nan}, FrameRefusal.NAN_INPUT),
        ({"qW": 2.0}, FrameRefusal.DENORMALIZED_QUATERNION),
        ({"src_frame_id": ""}, FrameRefusal.NO_FRAME_ID),
        ({"dst_frame_id": ""}, FrameRefusal.NO_CHILD_FRAME_ID),
        ({"dst_frame_id": "map"}, FrameRefusal.SELF_TRANSFORM),
        ({"timestamp": math.nan}, FrameRefusal.INVALID_STAMP),
        ({"timestamp": 1e300}, FrameRefusal.INVALID_STAMP),
    ],
)
@pytest.mark.parametrize("static", [0, 1])
def test_invalid_input_is_an_error_and_the_rest_is_inserted(
    rig: ExchangeRig, clock: StoppedClock, bad: dict[str, Any], reason: FrameRefusal, static: int
) -> None:
    whole = {"src_frame_id": "map", "dst_frame_id": "base", "timestamp": clock.system, "isStatic": static, **bad}
    rpc = Setter(rig.exchange)
    with pytest.raises(CallFailed, match=reason):
        rpc.setTransformsRPC([FrameTransform(**whole), frame("map", "good", clock.system)])
    assert list(rig.seen()) == ["good"]
    assert [t.child_frame_id for t in rig.message] == ["good"]
    assert not rig.static


@pytest.mark.parametrize(
    "bad", [{"qW": 0.0}, {"tX": math.nan}, {"src_frame_id": ""}, {"src_frame_id": "lidar"}, {"src_frame_id": "/lidar"}]
)
@pytest.mark.parametrize("static", [False, True])
def test_a_refused_static_transform_leaves_the_hubs_frame_unchanged(
    rig: ExchangeRig, clock: StoppedClock, bad: dict[str, Any], static: bool
) -> None:
    rig.receive("base", "lidar", static=static, x=1.0)
    whole = {"src_frame_id": "base", "dst_frame_id": "lidar", "timestamp": clock.system, "isStatic": 1, **bad}
    assert rig.set(FrameTransform(**whole)) is not None
    assert rig.buffer.lookup_transform("base", "lidar").translation == (1.0, 0.0, 0.0)


def test_a_stamp_far_ahead_is_refused(rig: ExchangeRig, clock: StoppedClock) -> None:
    assert rig.set(frame("map", "base", clock.system + 1.5)) is None
    assert rig.set(frame("map", "base", clock.system + 5.0)) is FrameRefusal.FUTURE
    assert len(rig.message) == 1


def test_a_name_that_is_not_utf8_is_shown_with_question_marks(rig: ExchangeRig, clock: StoppedClock) -> None:
    name = bytes([0xE4, 0x62]).decode("utf-8", "surrogateescape")
    assert rig.set(frame("map", name, clock.system, isStatic=1)) is None
    assert rig.static[-1][0].child_frame_id == "?b"


def test_a_loop_is_never_shown_because_yarps_clients_would_hang(rig: ExchangeRig, clock: StoppedClock) -> None:
    rig.receive("a", "b")
    rig.receive("b", "c")
    rig.set(frame("c", "a", clock.system))
    assert sorted(rig.seen()) == ["b", "c"]
    assert rig.view.left_out["loop"] == 1
    clock.system += 2.0  # the other frames have expired
    rig.set(frame("c", "a", clock.system))
    assert sorted(rig.seen()) == ["a"]


def test_a_frame_gets_its_newest_parent_and_both_parents_are_reported(rig: ExchangeRig, clock: StoppedClock) -> None:
    rig.receive("odom", "base")
    rig.receive("map", "base", rig.run.now_ns() - 50_000_000)
    assert rig.seen()["base"].src_frame_id == "odom"
    clock.system += 0.01
    rig.set(frame("map", "base", clock.system))
    assert rig.seen()["base"].src_frame_id == "map"
    assert {s.authority for s in rig.buffer.conflicts()[0].sources} == {"/node", "yarp"}


def simulated(seconds: float) -> RunClock:
    run = RunClock(simulated=True)
    run.receive(tick(seconds))
    return run


def tick(seconds: float) -> bytes:
    whole, nanoseconds = divmod(round(seconds * 1e9), 1_000_000_000)
    return bytes([0, 1, 0, 0]) + whole.to_bytes(4, "little") + nanoseconds.to_bytes(4, "little")


@pytest.mark.parametrize(("on_run_clock", "shown"), [(True, 100.0), (False, 1_795_000_000.0)])
def test_stamps_are_converted_to_a_simulations_clock(clock: StoppedClock, on_run_clock: bool, shown: float) -> None:
    rig = ExchangeRig(simulated(100.0), on_run_clock=on_run_clock)
    rig.receive("odom", "base")
    assert rig.seen()["base"].timestamp == shown
    rig.set(frame("base", "on_its_clock", 99.95), frame("base", "on_the_systems", clock.system - 0.05))
    assert [t.stamp for t in rig.message] == pytest.approx([99_950_000_000] * 2, abs=1000)
    assert {round(rig.seen()[n].timestamp, 6) for n in ("on_its_clock", "on_the_systems")} == {round(shown - 0.05, 6)}
    rig.run.receive(tick(100.3))
    clock.system += 0.3
    assert list(rig.seen()) == ["base"]
    rig.receive("base", "lidar", 0, static=True)
    rig.run.receive(tick(1.0))
    rig.exchange.forget_timed()
    assert list(rig.seen()) == ["lidar"]
    assert rig.set(frame("map", "base", 1.0)) is None
    assert sorted(rig.seen()) == ["base", "lidar"]


def test_frames_are_counted_while_another_thread_sets_one(rig: ExchangeRig, clock: StoppedClock) -> None:
    class Counted:
        """A frame during whose count another frame is set, as by a thread of a YARP port."""

        @property
        def ours(self) -> bool:
            rig.set(frame("map", "late", clock.system))
            return True

    rig.set(frame("map", "base", clock.system))
    rig.view._entries["base"] = Counted()  # type: ignore[assignment]
    assert rig.view.ours == 1


def test_the_get_call_returns_all_frames(rig: ExchangeRig) -> None:
    rig.receive("odom", "base")
    outcome, transforms = Getter(rig.exchange).getTransformsRPC()
    assert outcome
    assert [t.dst_frame_id for t in transforms] == ["base"]
