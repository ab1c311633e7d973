"""A simulated base, its planner, the worker of the planner's side and the ROS master; each of them can fail."""

from __future__ import annotations

import random
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from bridge.config.sections.navigation import NavigationSection
from bridge.hub.endpoints.calls import CallError
from bridge.messages.actions import GoalState, names
from tests.peers.navigation.simulated_hub import Clock, Hub

SPEED, BRAKE = 0.5, 0.6  # m/s, m/s²
MOVING = 0.03  # m/s above which the base counts as moving
TICK = 0.05


@dataclass
class PlannerGoal:
    """A goal that the planner has accepted."""

    id: bytes
    until: float
    status: GoalState = GoalState.EXECUTING
    waiting: list[Callable[[Any], None]] = field(default_factory=list)
    result: dict[str, Any] = field(default_factory=dict)


class PlannerSide(ABC):
    """Base, planner, worker and master on the hub. ``planner`` is move_base, or nav2 with its separate controller."""

    def __init__(self, seed: int, clock: Clock) -> None:
        self.random = random.Random(seed)
        self.clock = clock
        self.planner = self.random.choice(("move_base", "nav2"))
        self.side = {"move_base": "ros1", "nav2": "ros2"}[self.planner]
        self.has_odometry = self.random.random() < 0.8
        self.hub = Hub()
        self.section = NavigationSection(planner=self.planner, patience=5.0)
        self.action = self.section.at(self.planner)
        self.controller = "/follow_path"
        # the base
        self.x = self.v = 0.0
        self._moving_since: float | None = None
        self.bridged = False  # whether its velocities come through the worker of the planner's side
        self._driven_at = 0.0
        # the planner's process
        self.planner_alive, self.planner_hangs = True, False
        self._when_awake: list[Callable[[], None]] = []
        self.goals: dict[bytes, PlannerGoal] = {}
        self.orphan_until = 0.0  # until then, a controller whose navigator was killed drives on
        self.controller_until = 0.0  # when a FollowPath goal that outlives its NavigateToPose goal ends
        self._commanded_at = 0.0
        self.planner_registered = True  # with the ROS master
        # the other processes
        self.master_alive = True
        self.worker_alive = True
        self.generation = 0
        self.gid = b""
        self._expose()

    @property
    @abstractmethod
    def held(self) -> bool:
        """Return whether the gateway holds the planner's velocities."""

    # -- base and planner ----------------------------------------------------------------------------------------------

    def _active(self) -> list[PlannerGoal]:
        return [goal for goal in self.goals.values() if not goal.status.ended]

    @property
    def commanded(self) -> bool:
        """Return whether the planner's programs command the base now."""
        runs = self.planner_alive and not self.planner_hangs
        if self.clock.now < self.orphan_until:
            return True
        return runs and (bool(self._active()) or self.clock.now < self.controller_until)

    def step(self) -> None:
        """Simulate one `TICK` of the planner and the base."""
        now = self.clock.now
        if self.commanded:
            self._commanded_at = now
        # if the planner falls silent, the base keeps its last velocity for 0.5 s, its timeout, then brakes
        passes = not self.bridged or (self.worker_alive and bool(self.gid) and not self.held)
        if self.commanded and passes:
            self._driven_at = now
        silent = not self.planner_alive or self.planner_hangs or not passes
        driven = (self.commanded and passes) or (silent and self.v > 0.0 and now < self._driven_at + 0.5)
        self.v = SPEED if driven else max(0.0, self.v - BRAKE * TICK)
        self.x += self.v * TICK
        moving = self.v > MOVING
        self._moving_since = (self._moving_since or now) if moving else None
        self._publish_velocity()
        for goal in self._active():
            if self.planner_alive and not self.planner_hangs and now >= goal.until:
                self._end(goal, GoalState.SUCCEEDED)

    def _publish_velocity(self) -> None:
        """Publish the planner's velocity on the hub through the side's worker, unless the gateway holds it."""
        passes = self.worker_alive and self.gid and not self.held
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
        driven = bool(self._active()) or self.clock.now < self.controller_until
        running = self.clock.now < self.orphan_until or (self.planner_alive and driven)
        status = GoalState.EXECUTING if running else GoalState.CANCELED
        entry = {"goal_info": {"goal_id": {"uuid": list(b"controller-goal-")}}, "status": int(status)}
        topic = names(self.controller).status
        if topic in self.hub.publishers:
            self.hub.publish(topic, self.gid + b"c", {"status_list": [entry]})

    # -- the side's worker ---------------------------------------------------------------------------------------------

    def _expose(self) -> None:
        """Announce the parts of the planner's action on the hub one by one, as the worker does during discovery."""
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
        if (
            self.side == "ros1" or self.goals
        ):  # actionlib repeats its list, but rcl's servers publish theirs only with a goal

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
        """Remove the action's parts from the hub one by one, and fail pending calls, as if planner or worker exited.

        The parts of a killed DDS program can remain for its ``lease`` (seconds).
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
        self.controller_until = self.orphan_until = 0.0
        self._publish_controller()
        answer({"return_code": 0, "goals_canceling": []})

    # -- faults --------------------------------------------------------------------------------------------------------

    def kill_planner(self) -> None:
        if self.planner_alive:
            self.planner_alive = False
            self.wake_planner()  # fails the requests that the planner has not read
            self.controller_until = 0.0
            self._withdraw(self._lease())
            self.goals.clear()

    def _lease(self) -> float:
        return self.random.choice((0.0, 0.0, 19.0)) if self.side == "ros2" else 0.0

    def kill_navigator(self) -> None:
        """Kill bt_navigator while its controller continues to drive."""
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
        """Let bt_navigator abort its goal while its controller continues to drive."""
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
        """Let the worker discover the planner; on ROS 1, this needs the master."""
        if not self.worker_alive:
            return
        joined = self.side == "ros2" or self.master_alive
        if joined:
            self.hub.sides.add(self.side)
        if joined and self.planner_alive and self.planner_registered and not self.gid:
            self._expose()

    def kill_master(self) -> None:
        self.master_alive = False  # existing connections stay open

    def start_master(self) -> None:
        if not self.master_alive:
            self.master_alive = True
            self.clock.after(0.5, self._find)

    def foreign_goal(self) -> None:
        """Send a goal from the planner's own client, which on ROS 1 finds the planner through the master."""
        if self.planner_alive and not self.planner_hangs and self.planner_registered:
            self._accept(self.random.randbytes(16))
