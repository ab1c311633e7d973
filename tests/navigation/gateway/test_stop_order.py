"""A stop or pause is confirmed by the planner and by the base, and each client that waits for it is answered once."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge import state_machine
from bridge.messages.values import MessageWriter
from bridge.messages.velocities import TWIST, TWIST_STAMPED
from navigation.frames import FramesError
from navigation.gateway import motion, stop
from navigation.gateway.machine import StopState
from navigation.gateway.motion import SILENCE_SECONDS, STANDING_SECONDS, ZERO_SECONDS, Motion, VelocityWatch
from navigation.gateway.stop import (
    HELD_SECONDS,
    OVERRIDE_SECONDS,
    SETTLING_SECONDS,
    StopOrder,
    StopWaiters,
)
from navigation.pose import Pose
from tests.peers.hub.node import REGISTRY
from tests.peers.navigation.simulated_hub import Clock

TICK = 0.1
LONG = 600.0


def command(kind: str, velocity: float, frame: str = "base_link") -> bytes:
    """Return the CDR of a forward velocity in m/s; ``frame`` is used only for a stamped one."""
    twist = {"linear": {"x": velocity}}
    message = twist if kind == TWIST else {"header": {"frame_id": frame}, "twist": twist}
    return MessageWriter(REGISTRY.schema(kind)).message(message)


class Base:
    """A base with odometry and publishers of velocity commands, and a stop order; ``run`` advances the time.

    Attributes:
        speed: m/s of the base.
        odometry: whether it publishes odometry.
        lag: seconds by which odometry arrives late.
        commands: velocities that are published in each step, m/s.
        kind: type of these commands.
        form: the type that the base subscribes to, "" if it is unknown.
        carried: the type that a route carries to a side, "" without a route.
        released: whether the planner has released its goals.
        reachable: whether the planner is reachable.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = Clock()
        for module in (state_machine, motion, stop):
            monkeypatch.setattr(module, "time", self.clock)
        self.speed, self._x = 0.5, 0.0
        self.odometry = True
        self.lag = 0.0
        self._track: list[tuple[float, float]] = []
        self.commands: tuple[float, ...] = ()
        self.kind = TWIST
        self.released, self.reachable = False, True
        self._seen_at = self.clock.now
        self.subscribed: list[tuple[str, Callable[[bytes], None]]] = []
        self.form = self.carried = ""
        graph = SimpleNamespace(subscriptions=self._subscriptions, velocities=self._velocities)
        self.hub = SimpleNamespace(graph=graph)
        self.hub.graph.origin_of = lambda _: None
        host = SimpleNamespace(node=self)
        frames = SimpleNamespace(odometry=self._pose)
        self.motion = Motion(cast("Any", frames), lambda: round(self.clock.now * 1e9))
        self.order = StopOrder(self.motion, VelocityWatch(cast("Any", host), "/cmd_vel"))
        self.states: list[StopState] = []

    def subscription_cdr(self, topic: str, kind: str, receive: Callable[[bytes], None], *_: Any, **__: Any) -> Any:
        assert topic == "/cmd_vel"
        self.subscribed.append((kind, receive))
        return self.subscribed[-1]

    def release(self, subscription: tuple[str, Callable[[bytes], None]]) -> None:
        self.subscribed.remove(subscription)

    def _velocities(self) -> list[tuple[str, str, str]]:
        return [("zid", "/cmd_vel", self.form)] if self.form else []

    def _subscriptions(self, _topic: str) -> list[Any]:
        route = SimpleNamespace(origin="ros2", pending=False, type_name=self.carried)
        return [route] if self.carried else []

    def _pose(self) -> Pose:
        if not self.odometry:
            raise FramesError("odometry is missing")
        at, x = next(seen for seen in reversed(self._track) if seen[0] <= self.clock.now - self.lag + TICK / 10)
        return Pose(x, 0.0, 0.0, round(at * 1e9))

    def step(self) -> StopState:
        self.clock.now += TICK
        self._x += self.speed * TICK
        self._track.append((self.clock.now, self._x))
        for velocity in self.commands:
            for kind, receive in list(self.subscribed):
                if kind == self.kind:
                    receive(command(kind, velocity))
        if self.reachable:
            self._seen_at = self.clock.now
        self.motion.poll()
        self.order.update(released=self.released, seen_at=self._seen_at)
        if self.order.state not in self.states[-1:]:
            self.states.append(self.order.state)
        return self.order.state

    def run(self, seconds: float) -> StopState:
        """Let time pass; returns the state at the end."""
        for _ in range(round(seconds / TICK)):
            self.step()
        return self.order.state

    def until(self, state: StopState, within: float = LONG) -> float:
        """Return the seconds until the order reaches a state; fail after ``within`` seconds."""
        begin = self.clock.now
        while self.step() is not state:
            assert self.clock.now < begin + within, f"{self.order.state} after {within} s, not {state}"
        return self.clock.now - begin


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch) -> Base:
    started = Base(monkeypatch)
    started.run(1.0)
    return started


# -- with odometry -----------------------------------------------------------------------------------------------------


def test_without_a_request_there_is_no_stop(base: Base) -> None:
    base.released, base.speed = True, 0.0
    assert base.run(LONG) is StopState.NONE
    assert not base.order.confirmed


def test_a_planner_that_releases_its_goals_first_does_not_confirm_that_the_base_stands(base: Base) -> None:
    base.order.ask("it was stopped")
    assert base.run(1.0) is StopState.ASKED
    base.released = True
    assert base.run(2.0) is StopState.SETTLING
    assert not base.order.confirmed
    base.speed = 0.0
    assert base.until(StopState.CONFIRMED, 2.0) >= STANDING_SECONDS
    assert base.order.confirmed


def test_a_base_that_stands_first_does_not_confirm_that_the_planner_has_released_its_goals(base: Base) -> None:
    base.order.ask("it was stopped")
    base.speed = 0.0
    assert base.run(OVERRIDE_SECONDS) is StopState.ASKED
    assert not base.order.confirmed, "the planner still has time to release its goals"
    base.until(StopState.RESTING, 2.0)
    base.released = True
    assert base.step() is StopState.CONFIRMED


def test_a_base_that_stood_before_the_request_does_not_confirm_the_stop(base: Base) -> None:
    base.speed = 0.0
    base.run(2.0)
    base.released = True
    base.order.ask("it was stopped")
    assert base.run(STANDING_SECONDS - TICK) is StopState.SETTLING, "odometry from before the stop does not count"
    base.until(StopState.CONFIRMED, 0.5)


def test_odometry_that_was_measured_before_the_request_and_arrives_after_it_does_not_confirm_the_stop(
    base: Base,
) -> None:
    """A starved worker delays odometry; the base begins to move just before the stop, and the planner releases it."""
    base.speed, base.lag = 0.0, 0.4
    base.run(2.0)
    base.speed, base.released = 0.5, True
    base.order.ask("it was stopped")
    assert base.run(1.0) is StopState.SETTLING
    assert StopState.CONFIRMED not in base.states
    base.speed = 0.0
    assert base.until(StopState.CONFIRMED, 2.0) >= STANDING_SECONDS + base.lag - TICK


def test_a_standing_base_confirms_the_stop_if_the_planner_is_late(base: Base) -> None:
    base.order.ask("it was stopped")
    base.speed = 0.0
    base.run(OVERRIDE_SECONDS + STANDING_SECONDS - 2 * TICK)
    assert base.order.state is StopState.ASKED, "the base may stand only because the gateway commands zero"
    base.run(5 * TICK)
    assert base.order.state is StopState.RESTING
    assert base.order.confirmed
    assert base.order.state.held, "the planner may still drive: its velocities stay out of the hub"


def test_a_base_that_moves_again_before_the_planner_released_its_goals_is_being_stopped_again(base: Base) -> None:
    base.order.ask("it was stopped")
    base.speed = 0.0
    base.until(StopState.RESTING, 2.0)
    base.run(2.0)
    assert base.order.confirmed
    base.speed = 0.5
    assert base.run(0.5) is StopState.ASKED
    assert not base.order.confirmed
    base.speed = 0.0
    base.until(StopState.RESTING, 2.0)


def test_a_base_that_moves_again_in_the_step_of_the_release_is_not_confirmed(base: Base) -> None:
    base.order.ask("it was stopped")
    base.speed = 0.0
    base.until(StopState.RESTING, 2.0)
    base.speed, base.released = 0.5, True
    assert base.step() is not StopState.CONFIRMED
    assert base.run(1.0) is StopState.SETTLING
    assert StopState.CONFIRMED not in base.states


def test_a_goal_that_appears_after_the_release_has_to_end_too(base: Base) -> None:
    base.order.ask("it was stopped")
    base.released = True
    base.until(StopState.SETTLING, 1.0)
    base.released = False
    assert base.step() is StopState.ASKED
    assert base.order.state.held


def test_odometry_that_falls_silent_confirms_nothing(base: Base) -> None:
    base.order.ask("it was stopped")
    base.commands = (0.5,)
    base.odometry = False
    base.released = True
    assert base.run(SETTLING_SECONDS - 1.0) is StopState.SETTLING
    assert StopState.CONFIRMED not in base.states


# -- without odometry --------------------------------------------------------------------------------------------------


@pytest.fixture
def blind(base: Base) -> Base:
    base.odometry = False
    base.run(1.0)
    return base


def test_without_odometry_zero_velocities_confirm_the_stop_once_the_planner_has_released_its_goals(blind: Base) -> None:
    blind.order.ask("it was stopped")
    blind.commands = (0.0,)
    assert blind.run(5.0) is StopState.ASKED, (
        "velocities that are held do not reach the hub, so zeros mean nothing before the release"
    )
    blind.released = True
    assert ZERO_SECONDS <= blind.until(StopState.CONFIRMED, 1.0) < SILENCE_SECONDS
    assert not blind.subscribed, "the velocities are no longer read"


def test_without_odometry_silence_takes_longer_than_zeros_to_confirm_a_stop(blind: Base) -> None:
    blind.order.ask("it was stopped")
    blind.run(5.0)
    blind.released = True
    assert blind.until(StopState.CONFIRMED, 2.0) >= SILENCE_SECONDS


@pytest.mark.parametrize("kind", [TWIST, TWIST_STAMPED])
def test_without_odometry_velocities_other_than_zero_keep_a_stop_open(blind: Base, kind: str) -> None:
    blind.order.ask("it was stopped")
    blind.kind = kind
    blind.released, blind.commands = True, (0.5,)
    assert blind.run(3.0) is StopState.SETTLING
    blind.commands = (0.0,)
    assert blind.until(StopState.CONFIRMED, 1.0) >= ZERO_SECONDS


@pytest.mark.parametrize(("kind", "form"), [(TWIST, TWIST_STAMPED), (TWIST_STAMPED, TWIST)])
def test_without_odometry_zeros_in_a_form_that_the_base_ignores_count_as_silence(
    blind: Base, kind: str, form: str
) -> None:
    blind.order.ask("it was stopped")
    blind.kind, blind.form = kind, form
    blind.released, blind.commands = True, (0.0,)
    assert blind.until(StopState.CONFIRMED, 2.0) >= SILENCE_SECONDS


@pytest.mark.parametrize("form", [TWIST, ""], ids=["announced form", "unknown form"])
@pytest.mark.parametrize(("carried", "soonest"), [(TWIST, ZERO_SECONDS), (TWIST_STAMPED, SILENCE_SECONDS)])
def test_without_odometry_a_base_behind_a_route_of_the_other_form_is_not_known_to_stand(
    blind: Base, carried: str, soonest: float, form: str
) -> None:
    blind.order.ask("it was stopped")
    blind.form, blind.carried = form, carried
    blind.released, blind.commands = True, (0.0,)
    assert soonest <= blind.until(StopState.CONFIRMED, 2.0) < soonest + 0.5


def test_without_odometry_a_second_commander_that_drives_keeps_a_stop_open_despite_zeros(blind: Base) -> None:
    blind.order.ask("it was stopped")
    blind.released, blind.commands = True, (0.5, 0.0)
    assert blind.run(3.0) is StopState.SETTLING
    blind.commands = (0.0, 0.5)
    assert blind.run(1.5) is StopState.SETTLING
    assert StopState.CONFIRMED not in blind.states


def test_without_odometry_silence_before_the_release_does_not_count(blind: Base) -> None:
    """The velocities of an unreachable planner do not reach the hub."""
    blind.order.ask("it was stopped")
    blind.reachable = False
    assert blind.run(30.0) is StopState.ASKED
    blind.reachable = blind.released = True
    blind.commands = (0.5,)
    assert blind.run(2.0) is StopState.SETTLING


def test_without_odometry_commands_that_wait_for_a_stalled_process_are_not_silence(blind: Base) -> None:
    """The process is stopped, or starved: when it runs again, it has not read yet what arrived meanwhile."""
    blind.order.ask("it was stopped")
    blind.released, blind.commands = True, (0.5,)
    blind.run(1.0)
    blind.commands = ()
    blind.clock.now += 2.0
    assert blind.step() is StopState.SETTLING
    blind.commands = (0.5,)
    assert blind.run(1.0) is StopState.SETTLING
    assert StopState.CONFIRMED not in blind.states


def test_a_base_that_moved_when_its_odometry_ended_counts_as_moving_until_a_stop_is_confirmed(base: Base) -> None:
    base.odometry = False
    base.run(3.0)
    assert base.motion.base() is motion.Base.MOVING
    base.order.ask("it was stopped")
    base.released, base.commands = True, (0.0,)
    base.until(StopState.CONFIRMED, 1.0)
    assert base.motion.base() is motion.Base.UNKNOWN


def test_odometry_that_returns_takes_over(blind: Base) -> None:
    blind.order.ask("it was stopped")
    blind.released, blind.commands = True, (0.0,)
    blind.step()
    assert blind.subscribed
    blind.odometry = True
    assert blind.run(2.0) is StopState.SETTLING, "the base rolls despite zero commands"
    assert not blind.subscribed
    blind.speed = 0.0
    blind.until(StopState.CONFIRMED, 2.0)


# -- expiry and holding ------------------------------------------------------------------------------------------------


def test_a_base_that_still_moves_long_after_the_release_is_moved_by_something_else(base: Base) -> None:
    base.order.ask("it was stopped")
    base.released = True
    base.until(StopState.SETTLING, 1.0)
    assert base.until(StopState.EXPIRED, 10.0) == pytest.approx(SETTLING_SECONDS, abs=3 * TICK)
    assert not base.order.confirmed, "an expired order does not mean that the robot stands"
    assert not base.order.state.held
    base.speed = 0.0
    assert base.run(5.0) is StopState.EXPIRED


def test_a_planner_that_stays_unreachable_is_not_held_for_ever(base: Base) -> None:
    base.order.ask("it was stopped")
    base.reachable, base.speed = False, 0.0
    assert base.run(HELD_SECONDS - 1.0) is StopState.RESTING
    assert base.order.state.held
    base.until(StopState.EXPIRED, 3.0)
    assert not base.order.state.held


def test_time_for_which_the_process_stood_still_does_not_end_the_hold(base: Base) -> None:
    base.order.ask("it was stopped")
    base.reachable, base.speed = False, 0.0
    assert base.run(2.0) is StopState.RESTING
    base.clock.now += HELD_SECONDS
    base.order.excuse(HELD_SECONDS)
    assert base.order.age == pytest.approx(2.0)
    assert base.run(2.0) is StopState.RESTING
    base.until(StopState.EXPIRED, HELD_SECONDS)


def test_a_reachable_planner_with_a_moving_base_is_held_without_a_limit(base: Base) -> None:
    base.order.ask("it was stopped")
    assert base.run(2 * HELD_SECONDS) is StopState.ASKED
    assert base.order.state.held
    base.reachable = False
    assert base.run(2 * HELD_SECONDS) is StopState.ASKED, "the base moves"
    base.reachable, base.speed = True, 0.0
    assert base.run(2 * HELD_SECONDS) is StopState.RESTING
    assert base.order.state.held


def test_velocities_are_held_until_the_planner_has_released_its_goals(base: Base) -> None:
    assert not base.order.state.held
    base.order.ask("it was stopped")
    assert base.order.state.held
    base.released = True
    assert not base.step().held, "the planner's zero velocities have to reach the base"
    base.speed = 0.0
    assert not base.run(2.0).held


def test_a_second_request_joins_an_open_stop_and_begins_another_after_its_end(base: Base) -> None:
    base.order.ask("it was paused")
    base.run(3.0)
    base.order.ask("it was stopped")
    assert base.order.reason == "it was stopped"
    assert base.order.age == pytest.approx(3.0)
    base.speed, base.released = 0.0, True
    base.until(StopState.CONFIRMED, 2.0)
    base.order.ask("it was stopped")
    assert (base.order.state, base.order.age) == (StopState.ASKED, 0.0)
    assert not base.order.confirmed, "a second order needs its own confirmation"
    base.until(StopState.CONFIRMED, 1.0)


def test_a_second_stop_without_odometry_needs_its_own_zeros(blind: Base) -> None:
    blind.order.ask("it was stopped")
    blind.released = True
    blind.until(StopState.CONFIRMED, 2.0)
    blind.released, blind.commands = False, (0.5,)
    blind.run(1.0)
    blind.order.ask("it was stopped")
    blind.released, blind.commands = True, ()
    assert blind.until(StopState.CONFIRMED, 3.0) >= SILENCE_SECONDS - TICK


def test_a_dropped_stop_answers_its_client_and_is_not_confirmed_later(blind: Base) -> None:
    answers: list[str] = []
    blind.order.ask("it was stopped")
    blind.order.waiters.add(answers.append, LONG)
    blind.released, blind.commands = True, (0.5,)
    blind.step()
    blind.order.drop("another goal")
    assert answers == ["another goal"]
    assert not blind.subscribed
    assert blind.run(5.0) is StopState.NONE


# -- waiters -----------------------------------------------------------------------------------------------------------


def waiters(monkeypatch: pytest.MonkeyPatch) -> tuple[StopWaiters, Clock]:
    clock = Clock()
    monkeypatch.setattr(stop, "time", clock)
    return StopWaiters(), clock


def test_each_client_is_answered_once_when_the_stop_is_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    waiting, clock = waiters(monkeypatch)
    answers: list[tuple[int, str]] = []
    for number in range(3):
        waiting.add(lambda text, number=number: answers.append((number, text)), 2.5)  # type: ignore[misc]
    waiting.notify("it may still be moving")
    assert not answers
    waiting.notify("")
    waiting.notify("")
    waiting.fail("too late")
    clock.now += LONG
    waiting.notify("it may still be moving")
    assert answers == [(0, ""), (1, ""), (2, "")]


def test_a_client_whose_time_is_over_gets_the_reason_and_the_others_wait_on(monkeypatch: pytest.MonkeyPatch) -> None:
    waiting, clock = waiters(monkeypatch)
    early, late = list[str](), list[str]()
    waiting.add(early.append, 1.0)
    clock.now += 0.5
    waiting.add(late.append, 1.0)
    clock.now += 0.4
    waiting.notify("not yet")
    assert (early, late) == ([], [])
    clock.now += 0.1
    waiting.notify("not yet")
    assert (early, late) == (["not yet"], [])
    waiting.notify("")
    assert (early, late) == (["not yet"], [""])


def test_a_new_goal_fails_the_clients_that_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    waiting, _clock = waiters(monkeypatch)
    answers: list[str] = []
    waiting.add(answers.append, math.inf)
    waiting.fail("a client gave another goal")
    waiting.notify("")
    assert answers == ["a client gave another goal"]


def test_a_request_from_the_callback_of_an_answer_is_answered_in_the_next_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """A client may send its next request from the callback of its last one."""
    waiting, _clock = waiters(monkeypatch)
    answers: list[str] = []
    waiting.add(lambda text: (answers.append(text), waiting.add(answers.append, math.inf))[0], math.inf)
    waiting.notify("")
    assert answers == [""]
    waiting.notify("")
    assert answers == ["", ""]


@pytest.mark.parametrize("frame", ["", "a", "base", "base_link", "mobile_base_body_link"])
@pytest.mark.parametrize("velocity", [0.0, -0.01])
def test_stamped_velocity_is_read_whatever_its_frame(blind: Base, frame: str, velocity: float) -> None:
    blind.order.ask("it was stopped")
    blind.released = True
    blind.step()
    (receive,) = [receive for kind, receive in blind.subscribed if kind == TWIST_STAMPED]
    for _ in range(round(ZERO_SECONDS / TICK) + 3):
        receive(command(TWIST_STAMPED, velocity, frame))
        blind.step()
    assert blind.order.confirmed is (velocity == 0.0)


@pytest.mark.parametrize("size", [0, 4, 12, 16, 40])
def test_truncated_velocity_confirms_nothing(blind: Base, size: int) -> None:
    blind.order.ask("it was stopped")
    blind.released = True
    blind.step()
    for _ in range(30):
        for kind, receive in list(blind.subscribed):
            receive(command(kind, 0.0)[:size])
        blind.step()
    assert not blind.order.confirmed
