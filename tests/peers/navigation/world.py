"""A simulated deployment around the real gateway: hub, planner, the worker of its side, ROS master, base and clients.

Time is simulated, so one minute takes a tenth of a second. `World` fails the run as soon as a report to a client
contradicts the motion of the base; see `World.check`.
"""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from bridge import state_machine
from bridge.client import actions
from navigation.frames import FramesError
from navigation.gateway import (
    action_goals,
    contact,
    drive,
    execution,
    gateway,
    goal_list,
    motion,
    presence,
    stop,
)
from navigation.gateway import telemetry as telemetry_module
from navigation.gateway.gateway import Gateway
from navigation.pose import Pose
from navigation.status import State
from tests.peers.navigation.simulated_hub import Clock, Loop, Node
from tests.peers.navigation.simulated_planner import MOVING, TICK, PlannerSide

_TIMED = (
    action_goals, actions, contact, drive, execution, gateway, goal_list, motion, presence, state_machine, stop,
    telemetry_module,
)  # fmt: skip

NOTICE = 0.6
"""Seconds for which a report may be outdated after the base starts moving for a goal that the planner lists later."""

STALE, TRACK = 0.5, 200
"""Seconds after which odometry is stale, as in `RobotFrames`; number of stored poses, one per `TICK`."""

QUIET = 11.0
"""Seconds without a goal or motion after which a run ends; after 10 s the gateway gives up a stop or a planner."""

ENDED = frozenset((State.IDLE, State.PAUSED, State.ABORTED))


class ContradictionError(AssertionError):
    """A report to a client contradicts the motion of the base."""


class ClientGoal:
    """A goal that a client sent to the gateway, and its results."""

    def __init__(self, x: float) -> None:
        self.id = os.urandom(16)
        pose = {"position": {"x": x, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        self.goal = {"pose": {"header": {"frame_id": "map"}, "pose": pose}, "behavior_tree": ""}
        self.ends: list[tuple[str, str]] = []
        self.gateway_died = False

    def execute(self) -> None: ...
    def begin_cancel(self) -> None: ...
    def feedback(self, _feedback: Any) -> None: ...

    def succeed(self, _result: Any) -> None:
        self.ends.append(("succeeded", ""))

    def canceled(self, result: dict[str, Any]) -> None:
        self.ends.append(("canceled", result["error_msg"]))

    def abort(self, result: dict[str, Any]) -> None:
        self.ends.append(("aborted", result["error_msg"]))


class World(PlannerSide):
    """The gateway, the simulated planner's side, and clients whose reports are checked against the base."""

    def __init__(self, seed: int, clock: Clock) -> None:
        super().__init__(seed, clock)
        self.log: list[str] = []
        self._untrue_since: float | None = None
        self.gateway: Gateway | None = None
        self.loop = Loop(self.clock)
        self.client_goals: list[ClientGoal] = []
        self.answers: list[tuple[float, str, str]] = []
        self.lag = 0.0  # seconds by which odometry arrives late
        self._track: deque[tuple[float, float]] = deque([(clock.now, 0.0)], maxlen=TRACK)
        self.start_modules()
        self.clock.after(TICK, self._tick)

    @property
    def held(self) -> bool:
        return self.gateway is not None and self.gateway.held

    def _tick(self) -> None:
        self.step()
        self._track.append((self.clock.now, self.x))
        self.check()
        self.clock.after(TICK, self._tick)

    # -- the modules ---------------------------------------------------------------------------------------------------

    def kill_modules(self) -> None:
        if self.gateway is None:
            return
        self.loop.dead = True
        for subscriptions in self.hub.subscriptions.values():
            subscriptions.clear()
        self.gateway = None
        for goal in self.client_goals:
            goal.gateway_died = True
        self.answers = [(at, kind, "dead") for at, kind, _ in self.answers]
        if self.worker_alive:  # the worker cancels the goals of a gateway that has disconnected
            self.clock.after(self.random.uniform(0.05, 0.3), self._cancel_orphans)

    def _cancel_orphans(self) -> None:
        if self.worker_alive and self.planner_alive and self.gateway is None:
            for goal in self._active():
                if goal.waiting:
                    self._cancel({"goal_info": {"goal_id": {"uuid": list(goal.id)}}}, lambda _reply: None)

    def start_modules(self) -> None:
        if self.gateway is not None:
            return
        self.loop = loop = Loop(self.clock)
        node = Node(self.hub, loop)
        host: Any = SimpleNamespace(
            node=node,
            loop=loop,
            clock=SimpleNamespace(
                stamp=lambda: {"sec": 0, "nanosec": 0}, now_ns=lambda: round(self.clock.now * 1e9), simulated=False
            ),
            config=SimpleNamespace(name="robot", hosted={}),
            log=logging.getLogger("model"),
        )
        self.gateway = Gateway(host, self.section, self, lambda _message: None, lambda _held: None)  # type: ignore[arg-type]

    # -- frames --------------------------------------------------------------------------------------------------------

    def odometry(self) -> Pose:
        if not self.has_odometry:
            raise FramesError("odometry is missing")
        at, x = next(((at, x) for at, x in reversed(self._track) if at <= self.clock.now - self.lag), self._track[0])
        if self.clock.now - at > STALE:
            raise FramesError("the odometry is stale")
        return Pose(x, 0.0, 0.0, int(at * 1e9))

    def pose(self) -> Pose:
        return self.odometry()

    def on_map(self, frame: str) -> Pose:
        raise FramesError(f"{frame} is unknown")

    def delay_odometry(self) -> None:
        """Let odometry wait on its way, as in a starved worker."""
        self.lag = self.random.choice((0.3, 0.45, 3.0))

    def deliver_odometry(self) -> None:
        self.lag = 0.0

    def bridge_base(self) -> None:
        """Let the base be on another side than the planner."""
        self.bridged = True

    def stall_modules(self) -> None:
        """Let the gateway's process not run for a time."""
        self.loop.stall(self.random.uniform(0.3, 2.0))

    # -- clients -------------------------------------------------------------------------------------------------------

    def goal(self) -> None:
        if self.gateway is not None:
            goal = ClientGoal(self.random.uniform(1.0, 50.0))
            self.client_goals.append(goal)
            self.gateway.accept_goal(goal)  # type: ignore[arg-type]

    def cancel(self) -> None:
        gateway = self.gateway
        if gateway is not None and gateway.drive is not None and gateway.drive.goal is not None:
            gateway.cancel_goal(gateway.drive.goal)

    def stop(self) -> None:
        if self.gateway is not None:
            self.gateway.stop()
            self._request("stop")

    def pause(self) -> None:
        if self.gateway is not None and self.gateway.drive is not None:
            self.gateway.execution.pause()
            self._request("pause")

    def resume(self) -> bool:
        """Resume a paused drive; return whether there is one."""
        gateway = self.gateway
        if gateway is None or gateway.drive is None or gateway.drive.state.value not in ("pausing", "paused"):
            return False
        gateway.execution.resume()
        return True

    def _request(self, service: str) -> None:
        assert self.gateway is not None
        requested = self.clock.now

        def answered(trouble: str) -> None:
            if trouble == "" and self._moved_by_planner() and (self._moving_since or 0.0) < self.clock.now - NOTICE:
                raise ContradictionError(
                    self.report(f"the {service} requested at {requested:.2f} is confirmed at {self.v:.2f} m/s")
                )
            self.answers.append((self.clock.now, service, trouble))

        self.gateway.when_confirmed(answered)

    # -- the property --------------------------------------------------------------------------------------------------

    def _moved_by_planner(self) -> bool:
        """Return whether the base visibly moves; without odometry, a base with a zero command counts as standing."""
        return self.v > MOVING and (self.has_odometry or self.commanded)

    def check(self) -> None:
        """Check that no status reports an end, or the preparation of a drive, while the base moves."""
        if self.gateway is None:
            self._untrue_since = None
            return
        status = self.gateway.state()
        untrue = self._moved_by_planner() and status.state in ENDED | {State.PREPARING}
        if untrue and (not self.has_odometry or self.lag > STALE) and not self.gateway.link.state.reported:
            untrue = False  # the gateway has no information about the base, and does not claim to have any
        if untrue and self.loop.stalled and any(not self.gateway.link.mark.is_own(goal.id) for goal in self._active()):
            untrue = False  # it learns of the goal of a client that bypasses it when it runs again
        self._untrue_since = (self._untrue_since or self.clock.now) if untrue else None
        if self._untrue_since is not None and self.clock.now > self._untrue_since + NOTICE:
            raise ContradictionError(self.report(f"the status is {status} at {self.v:.2f} m/s"))

    def report(self, problem: str) -> str:
        return "\n".join([f"{self.clock.now - 1000:.2f}: {problem}", *self.log])

    def do(self, name: str) -> None:
        """Run the operation with this name, and log it for the report."""
        self.log.append(f"{self.clock.now - 1000:.2f}: {name} (planner {'alive' if self.planner_alive else 'dead'})")
        getattr(self, name)()

    def heal(self) -> None:
        """Restart everything that has failed."""
        for name in ("start_master", "start_planner", "wake_planner", "start_worker", "start_modules"):
            self.do(name)
        self.planner_registered = True
        self.lag = 0.0
        self.clock.after(1.0, self._find)

    def finish(self) -> None:
        """Heal all faults, wait until the robot rests, and check the ends of all goals.

        Each goal must have ended once; a goal of a killed gateway may have no end.
        """
        self.heal()
        for _ in range(3):
            self._run_until_quiet(25.0)
            if not self.resume() and not self._is_busy():
                break
        for goal in self.client_goals:
            expected = (0, 1) if goal.gateway_died else (1,)
            if len(goal.ends) not in expected:
                raise ContradictionError(self.report(f"a goal ended {len(goal.ends)} times: {goal.ends}"))

    def _run_until_quiet(self, seconds: float) -> None:
        """Run for a time, or until nothing has happened for longer than any timeout of the gateway."""
        end = self.clock.now + seconds
        quiet_until = self.clock.now + QUIET
        while self.clock.now < min(end, quiet_until):
            self.clock.run_to(self.clock.now + 0.5)
            if self._is_busy():
                quiet_until = self.clock.now + QUIET

    def _is_busy(self) -> bool:
        """Return whether a goal has not ended, or the planner commands the base, or the base moves."""
        ended = all(goal.ends or goal.gateway_died for goal in self.client_goals)
        return not ended or bool(self._active()) or self.commanded or self.v > 0.0


OPERATIONS = (
    "goal", "goal", "goal", "foreign_goal", "cancel", "stop", "stop", "pause", "pause", "resume", "give_up",
    "kill_planner", "kill_navigator", "start_planner", "hang_planner", "wake_planner", "kill_worker", "start_worker",
    "kill_master", "start_master", "kill_modules", "start_modules", "kill_all", "start_all",
)  # fmt: skip


LATE = (
    *OPERATIONS, "delay_odometry", "delay_odometry", "deliver_odometry", "bridge_base", "stall_modules", "stall_modules"
)  # fmt: skip
"""Also faults of timing: odometry that arrives late, and a gateway whose process stalls."""


def run(seed: int, operations: Sequence[str] = OPERATIONS) -> World:
    """Run operations in random order at random times, then heal all faults; raise `ContradictionError`."""
    with simulated(seed) as world:
        world.clock.run_to(world.clock.now + 1.0)
        for _ in range(world.random.randint(3, 14)):
            name = world.random.choice(operations)
            if name == "kill_all":
                for process in ("kill_worker", "kill_modules"):
                    world.do(process)
            elif name == "start_all":
                for process in ("start_worker", "start_modules"):
                    world.do(process)
            else:
                world.do(name)
            world.clock.run_to(world.clock.now + world.random.choice((0.05, 0.2, 0.7, 1.5, 3.0, 7.0)))
        world.finish()
        return world


@contextmanager
def simulated(seed: int) -> Iterator[World]:
    """Run the gateway's modules on the simulated time of a world."""
    with pytest.MonkeyPatch.context() as patched:
        clock = Clock()
        for module in _TIMED:
            patched.setattr(module, "time", clock)
        yield World(seed, clock)
