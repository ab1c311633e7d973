"""A simulated deployment around the real gateway: hub, planner, its side's worker, ROS master, base and clients.

Time is simulated, so a run of a minute takes a tenth of a second. `World` fails the run as soon as a word to a client
contradicts the base; see `World.check`.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import math
import os
import random
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.config.sections.navigation import NavigationSection
from bridge.hub.endpoints.calls import CallError
from bridge.messages.actions import GoalState, names
from bridge.modules import clients
from navigation.frames import FramesError
from navigation.gateway import (
    action_goals,
    contact,
    drive,
    execution,
    gateway,
    goal_list,
    machine,
    motion,
    presence,
    stop,
)
from navigation.gateway import telemetry as telemetry_module
from navigation.gateway.gateway import Gateway
from navigation.pose import Pose
from navigation.status import State

_TIMED = (
    action_goals, clients, contact, drive, execution, gateway, goal_list, machine, motion, presence, stop,
    telemetry_module,
)  # fmt: skip

SPEED, BRAKE = 0.5, 0.6  # m/s, m/s²
MOVING = 0.03  # m/s from which the base counts as moving
TICK = 0.05

NOTICE = 0.6
"""A word may lag this many seconds behind a base that begins to move: a goal that nobody has reported yet."""

ENDED = frozenset((State.IDLE, State.PAUSED, State.ABORTED))


class ContradictionError(AssertionError):
    """A word to a client contradicts the base."""


class Clock:
    """Simulated time and what is due in it."""

    def __init__(self) -> None:
        self.now = 1000.0
        self._due: list[tuple[float, int, Callable[[], Any]]] = []
        self._numbers = itertools.count()

    def monotonic(self) -> float:
        return self.now

    def after(self, seconds: float, action: Callable[[], Any]) -> None:
        heapq.heappush(self._due, (self.now + seconds, next(self._numbers), action))

    def run_to(self, end: float) -> None:
        while self._due and self._due[0][0] <= end:
            self.now, _, action = heapq.heappop(self._due)
            action()
        self.now = end


class Timer:
    """A timer of the gateway's loop."""

    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


class Loop:
    """The gateway's thread."""

    def __init__(self, clock: Clock) -> None:
        self._clock, self.dead = clock, False

    def _run(self, timer: Timer, action: Callable[[], Any]) -> None:
        if not (self.dead or timer.closed):
            action()

    def post(self, action: Callable[[], Any]) -> None:
        self.after(0.0, action)

    def after(self, seconds: float, action: Callable[[], Any]) -> Timer:
        timer = Timer()
        self._clock.after(seconds, lambda: self._run(timer, action))
        return timer

    def every(self, seconds: float, action: Callable[[], Any]) -> Timer:
        timer = Timer()

        def run() -> None:
            if not (self.dead or timer.closed):
                action()
                self._clock.after(seconds, run)

        self._clock.after(seconds, run)
        return timer


@dataclass
class Hub:
    """Tokens, latched messages and servers, as all sessions see them."""

    publishers: dict[str, set[bytes]] = field(default_factory=dict)
    servers: dict[str, Callable[[dict[str, Any], Callable[[Any], None]], None]] = field(default_factory=dict)
    gids: dict[str, bytes] = field(default_factory=dict)  # of the servers
    latched: dict[str, tuple[bytes, Any]] = field(default_factory=dict)
    subscriptions: dict[str, list[Subscription]] = field(default_factory=dict)
    sides: set[str] = field(default_factory=set)

    def publish(self, topic: str, gid: bytes, message: Any, *, keep: bool = True) -> None:
        if keep:
            self.latched[topic] = gid, message
        for subscription in list(self.subscriptions.get(topic, ())):
            subscription.deliver(gid, message)


class Subscription:
    """A subscription of the gateway's node."""

    def __init__(self, node: Node, topic: str, receive: Callable[[Any], None]) -> None:
        self._node, self._receive, self.topic = node, receive, topic
        self.sender = b""
        node.hub_state.subscriptions.setdefault(topic, []).append(self)
        if topic in node.hub_state.latched:
            gid, message = node.hub_state.latched[topic]
            node.loop.after(0.02, lambda: self._give(gid, message))

    def deliver(self, gid: bytes, message: Any) -> None:
        self._node.loop.after(0.005, lambda: self._give(gid, message))

    def _give(self, gid: bytes, message: Any) -> None:
        if self in self._node.hub_state.subscriptions.get(self.topic, ()):
            self.sender = gid
            self._receive(message)


class Client:
    """A service client of the gateway's node."""

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self._pending: dict[int, Callable[[Any], None]] = {}

    @property
    def ready(self) -> bool:
        return self._name in self._node.hub_state.servers

    def call(self, request: dict[str, Any], replied: Callable[[Any], None]) -> Callable[[], None]:
        server = self._node.hub_state.servers.get(self._name)

        def answer(reply: Any) -> None:
            self._node.loop.after(0.005, lambda: replied(reply))

        if server is None:
            answer(CallError(f"{self._name} has no server"))
        else:
            server(request, answer)
        return lambda: None


class Node:
    """The gateway's node on the hub."""

    def __init__(self, hub: Hub, loop: Loop) -> None:
        self.hub_state, self.loop = hub, loop
        graph = SimpleNamespace(
            publishers=lambda topic: [SimpleNamespace(gid=gid) for gid in hub.publishers.get(topic, ())],
            servers=lambda name: [SimpleNamespace(gid=hub.gids[name])] if name in hub.servers else [],
            origins=lambda: {side: SimpleNamespace(side=side) for side in hub.sides},
        )
        self.hub = SimpleNamespace(graph=graph, zid="gateway")

    def subscription(self, topic: str, _type: str, receive: Callable[[Any], None], _qos: Any = None) -> Subscription:
        return Subscription(self, topic, receive)

    def subscription_cdr(self, topic: str, *args: Any, **_options: Any) -> Subscription:
        return Subscription(self, topic, args[1])

    def client(self, name: str, _type: str) -> Client:
        return Client(self, name)

    def release(self, endpoint: Any) -> None:
        if isinstance(endpoint, Subscription):
            self.hub_state.subscriptions[endpoint.topic].remove(endpoint)


class ClientGoal:
    """A goal that a client gave to the gateway, and its ends."""

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


@dataclass
class PlannerGoal:
    """A goal at the planner."""

    id: bytes
    until: float
    status: GoalState = GoalState.EXECUTING
    waiting: list[Callable[[Any], None]] = field(default_factory=list)
    result: dict[str, Any] = field(default_factory=dict)


class World:
    """All of it. ``planner``: move_base, or nav2 with its separate controller."""

    def __init__(self, seed: int, clock: Clock) -> None:
        self.random = random.Random(seed)
        self.clock = clock
        self.planner = self.random.choice(("move_base", "nav2"))
        self.side = {"move_base": "ros1", "nav2": "ros2"}[self.planner]
        self.has_odometry = self.random.random() < 0.8
        self.log: list[str] = []
        self.hub = Hub()
        self.section = NavigationSection(planner=self.planner, patience=5.0)
        self.action = self.section.at(self.planner)
        self.controller = "/follow_path"
        # the base
        self.x = self.v = 0.0
        self._moving_since: float | None = None
        self._untrue_since: float | None = None
        # the planner's process
        self.planner_alive, self.planner_hangs = True, False
        self._when_awake: list[Callable[[], None]] = []
        self.goals: dict[bytes, PlannerGoal] = {}
        self.orphan_until = 0.0  # a controller whose navigator was killed drives on until then
        self.controller_until = 0.0  # a FollowPath goal that outlives its NavigateToPose goal ends then
        self._commanded_at = 0.0
        self.planner_registered = True  # at the ROS master
        # the other processes
        self.master_alive = True
        self.worker_alive = True
        self.worker_knows = True  # whether the worker has found the planner
        self.generation = 0
        self.gid = b""
        self.gateway: Gateway | None = None
        self.loop = Loop(self.clock)
        self.client_goals: list[ClientGoal] = []
        self.answers: list[tuple[float, str, str]] = []
        self.foreign_at = -math.inf
        self._expose()
        self.start_modules()
        self.clock.after(TICK, self._tick)

    # -- base and planner ----------------------------------------------------------------------------------------------

    def _active(self) -> list[PlannerGoal]:
        return [goal for goal in self.goals.values() if not goal.status.ended]

    @property
    def commanded(self) -> bool:
        """Whether the planner's programs command the base now."""
        runs = self.planner_alive and not self.planner_hangs
        if self.clock.now < self.orphan_until:
            return True
        return runs and (bool(self._active()) or self.clock.now < self.controller_until)

    def _tick(self) -> None:
        now = self.clock.now
        if self.commanded:
            self._commanded_at = now
        # a base keeps its last velocity for its time-out if the planner falls silent, then brakes
        silent = not self.planner_alive or self.planner_hangs
        driven = self.commanded or (silent and self.v > 0.0 and now < self._commanded_at + 0.5)
        self.v = SPEED if driven else max(0.0, self.v - BRAKE * TICK)
        self.x += self.v * TICK
        moving = self.v > MOVING
        self._moving_since = (self._moving_since or now) if moving else None
        self._publish_velocity()
        for goal in self._active():
            if self.planner_alive and not self.planner_hangs and now >= goal.until:
                self._end(goal, GoalState.SUCCEEDED)
        self.check()
        self.clock.after(TICK, self._tick)

    def _publish_velocity(self) -> None:
        """The planner's velocities come to the hub by its side's worker, unless the gateway holds them."""
        passes = self.worker_alive and self.gid and not (self.gateway is not None and self.gateway.held)
        if passes and self.planner_alive and not self.planner_hangs and self.clock.now < self._commanded_at + 0.2:
            velocity = struct.pack("<6d", SPEED if self.commanded else 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            self.hub.publish("/cmd_vel", b"planner", b"\0\1\0\0" + velocity, keep=False)

    def _end(self, goal: PlannerGoal, status: GoalState, **result: Any) -> None:
        goal.status, goal.result = status, result
        waiting, goal.waiting = goal.waiting, []
        for answer in waiting:
            answer({"status": int(status), "result": result})
        self._publish_list()

    def _publish_list(self) -> None:
        if self.gid and self.worker_alive:
            statuses = [self._entry(goal) for goal in list(self.goals.values())[-20:]]
            self.hub.publish(names(self.action).status, self.gid, {"status_list": statuses})
            if self.planner == "nav2":
                self._publish_controller()

    def _entry(self, goal: PlannerGoal) -> dict[str, Any]:
        return {"goal_info": {"goal_id": {"uuid": list(goal.id)}}, "status": int(goal.status)}

    def _publish_controller(self) -> None:
        running = self.planner_alive and (bool(self._active()) or self.clock.now < self.controller_until)
        status = GoalState.EXECUTING if running else GoalState.CANCELED
        entry = {"goal_info": {"goal_id": {"uuid": list(b"controller-goal-")}}, "status": int(status)}
        topic = names(self.controller).status
        if topic in self.hub.publishers:
            self.hub.publish(topic, self.gid + b"c", {"status_list": [entry]})

    # -- the side's worker ---------------------------------------------------------------------------------------------

    def _expose(self) -> None:
        """The worker has found the planner: the parts of its action come to the hub, one after the other."""
        self.generation += 1
        generation, gid = self.generation, self.random.randbytes(16)
        self.gid = gid
        self.hub.sides.add(self.side)
        parts = names(self.action)
        self.hub.gids |= {name: gid + name.encode() for name in (parts.send_goal, parts.get_result, parts.cancel_goal)}
        steps: list[Callable[[], None]] = [
            lambda: self.hub.servers.__setitem__(parts.send_goal, self._serve(generation, self._send_goal)),
            lambda: self.hub.servers.__setitem__(parts.get_result, self._serve(generation, self._get_result)),
            lambda: self.hub.servers.__setitem__(parts.cancel_goal, self._serve(generation, self._cancel)),
            lambda: self.hub.publishers.__setitem__(parts.feedback, {gid + b"f"}),
            lambda: self._expose_list(parts.status, gid),
        ]
        if self.planner == "nav2":
            steps.append(lambda: self._expose_controller(gid))
        for step in steps:
            delay = 0.0 if self.clock.now == 1000.0 else self.random.uniform(0.0, 0.5)
            self.clock.after(delay, lambda step=step: step() if self._current(generation) else None)  # type: ignore[misc]

    def _current(self, generation: int) -> bool:
        return self.generation == generation

    def _expose_list(self, topic: str, gid: bytes) -> None:
        self.hub.publishers[topic] = {gid}
        generation = self.generation
        if self.side == "ros1" or self.goals:  # actionlib repeats its list; rcl's servers publish it with a goal

            def first() -> None:
                if self._current(generation) and self.planner_alive:
                    self._publish_list()

            self.clock.after(self.random.uniform(0.05, 0.4), first)

    def _expose_controller(self, gid: bytes) -> None:
        parts = names(self.controller)
        self.hub.publishers[parts.status] = {gid + b"c"}
        self.hub.servers[parts.cancel_goal] = self._serve(self.generation, self._cancel_controller)
        self.clock.after(0.05, self._publish_controller)

    def _withdraw(self, lease: float = 0.0) -> None:
        """The planner or the worker has gone: the parts leave, one after the other, and pending calls fail.

        The parts of a program on DDS that was killed may stay for its lease.
        """
        self.generation += 1
        self.gid = b""
        parts, controller = names(self.action), names(self.controller)
        for name in (parts.send_goal, parts.get_result, parts.cancel_goal, controller.cancel_goal):
            generation = self.generation
            self.clock.after(
                lease + self.random.uniform(0.0, 0.6),
                lambda name=name, generation=generation: (  # type: ignore[misc]
                    self.hub.servers.pop(name, None) if self._current(generation) else None
                ),
            )
        for name in (parts.feedback, parts.status, controller.status):
            generation = self.generation
            self.clock.after(
                lease + self.random.uniform(0.0, 0.6),
                lambda name=name, generation=generation: (  # type: ignore[misc]
                    (self.hub.publishers.pop(name, None), self.hub.latched.pop(name, None))
                    if self._current(generation)
                    else None
                ),
            )
        for goal in self.goals.values():
            waiting, goal.waiting = goal.waiting, []
            for answer in waiting:
                self.clock.after(
                    self.random.uniform(0.0, 0.4),
                    lambda answer=answer: answer(CallError("the server left before it answered")),  # type: ignore[misc]
                )

    def _serve(self, generation: int, handler: Callable[..., None]) -> Callable[..., None]:
        def serve(request: dict[str, Any], answer: Callable[[Any], None]) -> None:
            def reach() -> None:
                if not self._current(generation) or not self.planner_alive or not self.worker_alive:
                    answer(CallError("the server left before it answered"))
                elif self.planner_hangs:
                    self._when_awake.append(reach)
                else:
                    handler(request, answer)

            self.clock.after(self.random.uniform(0.005, 0.08), reach)

        return serve

    def _send_goal(self, request: dict[str, Any], answer: Callable[[Any], None]) -> None:
        self._accept(bytes(request["goal_id"]["uuid"]))
        answer({"accepted": True, "stamp": {}})

    def _accept(self, goal_id: bytes) -> None:
        for goal in self._active():
            self._end(goal, GoalState.CANCELED if self.side == "ros1" else GoalState.ABORTED)
        self.goals[goal_id] = PlannerGoal(goal_id, self.clock.now + self.random.uniform(2.0, 12.0))
        self._publish_list()

    def _get_result(self, request: dict[str, Any], answer: Callable[[Any], None]) -> None:
        goal = self.goals.get(bytes(request["goal_id"]["uuid"]))
        if goal is None:
            answer({"status": 0, "result": {}})
        elif goal.status.ended:
            answer({"status": int(goal.status), "result": goal.result})
        else:
            goal.waiting.append(answer)

    def _cancel(self, request: dict[str, Any], answer: Callable[[Any], None]) -> None:
        goal_id = bytes(request["goal_info"]["goal_id"]["uuid"])
        for goal in self._active():
            if goal.id == goal_id or not any(goal_id):
                self.clock.after(
                    self.random.uniform(0.0, 0.3),
                    lambda goal=goal: self._end(goal, GoalState.CANCELED) if self._cancels(goal) else None,  # type: ignore[misc]
                )
        answer({"return_code": 0, "goals_canceling": []})

    def _cancels(self, goal: PlannerGoal) -> bool:
        return self.planner_alive and not self.planner_hangs and not goal.status.ended

    def _cancel_controller(self, _request: dict[str, Any], answer: Callable[[Any], None]) -> None:
        self.controller_until = 0.0
        self._publish_controller()
        answer({"return_code": 0, "goals_canceling": []})

    # -- faults --------------------------------------------------------------------------------------------------------

    def kill_planner(self) -> None:
        if self.planner_alive:
            self.planner_alive = False
            self.wake_planner()  # requests that it has not read fail
            self.controller_until = 0.0
            self._withdraw(self._lease())
            self.goals.clear()

    def _lease(self) -> float:
        return self.random.choice((0.0, 0.0, 19.0)) if self.side == "ros2" else 0.0

    def kill_navigator(self) -> None:
        """bt_navigator is killed while its controller drives on."""
        if self.planner == "nav2" and self.planner_alive:
            drives = self.commanded
            self.kill_planner()
            self.orphan_until = self.clock.now + 5.0 if drives else 0.0

    def start_planner(self) -> None:
        if not self.planner_alive:
            self.planner_alive = True
            self.planner_registered = self.side == "ros2" or self.master_alive
            self._find()

    def hang_planner(self) -> None:
        if self.planner_alive and not self.planner_hangs:
            self.planner_hangs, self._when_awake = True, []

    def wake_planner(self) -> None:
        if self.planner_hangs:
            self.planner_hangs = False
            pending, self._when_awake = self._when_awake, []
            for action in pending:
                action()

    def give_up(self) -> None:
        """bt_navigator gives up while its controller drives on."""
        goals = self._active()
        if self.planner == "nav2" and goals and self.planner_alive and not self.planner_hangs:
            self.controller_until = self.clock.now + 12.0
            self._end(goals[-1], GoalState.ABORTED)

    def kill_worker(self) -> None:
        if self.worker_alive:
            self.worker_alive = False
            self._withdraw()
            self.hub.sides.discard(self.side)

    def start_worker(self) -> None:
        if not self.worker_alive:
            self.worker_alive = True
            self.clock.after(self.random.uniform(0.1, 1.0), self._find)

    def _find(self) -> None:
        """The worker looks for the planner, on ROS 1 with the master's help."""
        if not self.worker_alive:
            return
        joined = self.side == "ros2" or self.master_alive
        if joined:
            self.hub.sides.add(self.side)
        if joined and self.planner_alive and self.planner_registered and not self.gid:
            self._expose()

    def kill_master(self) -> None:
        self.master_alive = False  # connections that stand go on

    def start_master(self) -> None:
        if not self.master_alive:
            self.master_alive = True
            self.clock.after(0.5, self._find)

    def kill_modules(self) -> None:
        if self.gateway is None:
            return
        self.loop.dead = True
        for subscriptions in self.hub.subscriptions.values():
            subscriptions.clear()
        self.gateway = None
        for goal in self.client_goals:
            goal.gateway_died = True
        self.answers = [(at, what, "dead") for at, what, _ in self.answers]
        if self.worker_alive:  # it cancels the goals that the gateway gave
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
            clock=SimpleNamespace(stamp=lambda: {"sec": 0, "nanosec": 0}, simulated=False),
            config=SimpleNamespace(name="robot", hosted={}),
            log=logging.getLogger("model"),
        )
        self.gateway = Gateway(host, self.section, self, lambda _message: None, lambda _held: None)  # type: ignore[arg-type]

    # -- frames --------------------------------------------------------------------------------------------------------

    def odometry(self) -> Pose:
        if not self.has_odometry:
            raise FramesError("odometry is missing")
        return Pose(self.x, 0.0, 0.0, int(self.clock.now * 1e9))

    def pose(self) -> Pose:
        return self.odometry()

    def on_map(self, frame: str) -> Pose:
        raise FramesError(f"{frame} is unknown")

    # -- clients -------------------------------------------------------------------------------------------------------

    def goal(self) -> None:
        if self.gateway is not None:
            goal = ClientGoal(self.random.uniform(1.0, 50.0))
            self.client_goals.append(goal)
            self.gateway.accept_goal(goal)  # type: ignore[arg-type]

    def foreign_goal(self) -> None:
        """The planner's own client, which has found it with the master's help, gives it a goal."""
        if self.planner_alive and not self.planner_hangs and self.planner_registered:
            self.foreign_at = self.clock.now
            self._accept(self.random.randbytes(16))

    def cancel(self) -> None:
        gateway = self.gateway
        if gateway is not None and gateway.drive is not None and gateway.drive.goal is not None:
            gateway.cancel_goal(gateway.drive.goal)

    def stop(self) -> None:
        if self.gateway is not None:
            self.gateway.stop()
            self._ask("stop")

    def pause(self) -> None:
        if self.gateway is not None and self.gateway.drive is not None:
            self.gateway.execution.pause()
            self._ask("pause")

    def resume(self) -> None:
        gateway = self.gateway
        if gateway is not None and gateway.drive is not None and gateway.drive.state.value in ("pausing", "paused"):
            gateway.execution.resume()

    def _ask(self, what: str) -> None:
        assert self.gateway is not None
        asked = self.clock.now

        def answered(trouble: str) -> None:
            if trouble == "" and self._moved_by_planner() and (self._moving_since or 0.0) < self.clock.now - NOTICE:
                raise ContradictionError(
                    self.report(f"a {what} asked for at {asked:.2f} is answered ok at {self.v:.2f} m/s")
                )
            self.answers.append((self.clock.now, what, trouble))

        self.gateway.when_confirmed(answered)

    # -- the property --------------------------------------------------------------------------------------------------

    def _moved_by_planner(self) -> bool:
        """Without odometry a base that has been commanded zero counts as standing: nothing shows its motion."""
        return self.v > MOVING and (self.has_odometry or self.commanded)

    def check(self) -> None:
        """No word that means an end, or that the robot has not begun to move, while the base moves."""
        if self.gateway is None:
            self._untrue_since = None
            return
        status = self.gateway.state()
        untrue = self._moved_by_planner() and status.state in ENDED | {State.PREPARING}
        if untrue and not self.has_odometry and not self.gateway.link.state.reported:
            untrue = False  # nothing at all is known, and nothing else is claimed
        self._untrue_since = (self._untrue_since or self.clock.now) if untrue else None
        if self._untrue_since is not None and self.clock.now > self._untrue_since + NOTICE:
            raise ContradictionError(self.report(f"the status is {status} at {self.v:.2f} m/s"))

    def report(self, what: str) -> str:
        return "\n".join([f"{self.clock.now - 1000:.2f}: {what}", *self.log])

    def do(self, name: str) -> None:
        """Do something by its name, and note it for the report."""
        self.log.append(f"{self.clock.now - 1000:.2f}: {name} (planner {'alive' if self.planner_alive else 'dead'})")
        getattr(self, name)()

    def heal(self) -> None:
        """Everything that failed returns."""
        for name in ("start_master", "start_planner", "wake_planner", "start_worker", "start_modules"):
            self.do(name)
        self.planner_registered = True
        self.clock.after(1.0, self._find)

    def finish(self) -> None:
        """Once all is back, each goal has had one end, and everything comes to rest."""
        self.heal()
        for _ in range(2):
            self.clock.run_to(self.clock.now + 25.0)
            self.resume()
        self.clock.run_to(self.clock.now + 25.0)
        for goal in self.client_goals:
            expected = (0, 1) if goal.gateway_died else (1,)
            if len(goal.ends) not in expected:
                raise ContradictionError(self.report(f"a goal had {len(goal.ends)} ends: {goal.ends}"))


OPERATIONS = (
    "goal", "goal", "goal", "foreign_goal", "cancel", "stop", "stop", "pause", "pause", "resume", "give_up",
    "kill_planner", "kill_navigator", "start_planner", "hang_planner", "wake_planner", "kill_worker", "start_worker",
    "kill_master", "start_master", "kill_modules", "start_modules", "kill_all", "start_all",
)  # fmt: skip


def run(seed: int) -> World:
    """One run: operations in random order at random times, then everything heals. Raises `ContradictionError`."""
    with simulated(seed) as world:
        world.clock.run_to(world.clock.now + 1.0)
        for _ in range(world.random.randint(3, 14)):
            name = world.random.choice(OPERATIONS)
            if name == "kill_all":
                for each in ("kill_worker", "kill_modules"):
                    world.do(each)
            elif name == "start_all":
                for each in ("start_worker", "start_modules"):
                    world.do(each)
            else:
                world.do(name)
            world.clock.run_to(world.clock.now + world.random.choice((0.05, 0.2, 0.7, 1.5, 3.0, 7.0)))
        world.finish()
        return world


@contextmanager
def simulated(seed: int) -> Iterator[World]:
    """Run the gateway's modules on a world's simulated time."""
    with pytest.MonkeyPatch.context() as patched:
        clock = Clock()
        for module in _TIMED:
            patched.setattr(module, "time", clock)
        yield World(seed, clock)
