"""RobotPathPlanner without a hub: plans paths, sends waypoints to a local navigator, and replans if necessary.

It behaves like robotology/navigation's ``robotPathPlannerDev``. Time is an argument; the caller calls
`PathPlanner.step` once per ``period`` of the section, by default 20 times per second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from bridge.messages.scan import LaserScan
from navigation.constraints import Constraints
from navigation.goals import MapPlace
from navigation.pose import Pose
from navigation.robot_path_planner.atlas import Atlas, Leg, leg
from navigation.robot_path_planner.ground import Clutter, Ground
from navigation.robot_path_planner.navigators import LocalNavigator
from navigation.robot_path_planner.path import (
    DriveTask,
    JumpDetector,
    Places,
    PlannedPath,
    Waypoint,
    blocked,
    cut,
    is_straight,
    length,
    passing,
    plan_path,
)
from navigation.robot_path_planner.section import RobotPathPlannerSection
from navigation.scan import clean_ranges
from navigation.status import Fault, PlanError, PlannerStatus, State

_JUMP = 0.5  # meters; if localization moves the robot by more than this or 30 degrees at once, a new path is planned
_WATCH = 0.5  # seconds between two checks of the path ahead
_AHEAD = 5.0  # meters of the path that are checked
_AGAIN = 2.0  # seconds until planning is tried again if no path was found
_GLITCH = 0.3  # seconds for which a missing pose does not matter
_NEARER = 0.5  # meters of progress toward the goal that reset the count of attempts
_PATIENCE_PER_METER, _LONGEST_PATIENCE = 2.0, 20.0
"""Seconds to wait for a blocked path to clear, per meter by which the alternative is longer, and their maximum."""
_DETOUR = 3.0
"""Meters by which a path around the laser's obstacles may be longer and still be preferred at the start."""
_AT_LINK = 3.0  # meters from a link's end within which the pose of a robot that has changed maps is accepted


class PathPlanner:
    """Drives one robot to one goal at a time."""

    def __init__(self, settings: RobotPathPlannerSection | None = None, atlas: Atlas | None = None) -> None:
        self.settings = settings or RobotPathPlannerSection()  # may be replaced; applies to the next plan
        self._atlas = atlas or Atlas()
        self.ground: Ground | None = None
        self.clutter: Clutter | None = None
        self.task: DriveTask | None = None
        self._halting = False
        self._braked: DriveTask | None = None
        self._paused_until = -math.inf
        self._jumps = JumpDetector()
        self._watched = -math.inf
        self.status = PlannerStatus()
        self._layers: dict[str, Places] = {}
        self.blind = ""  # why scans are unusable, else ""; set by the source of the scans
        self.silent = ""  # which layer has fallen silent, else ""; set by the source of the layers

    @property
    def active(self) -> bool:
        """Whether there is a goal."""
        return self.task is not None

    @property
    def target(self) -> MapPlace | None:
        return task.goal if (task := self.task) else None  # another thread reads this

    @property
    def waypoints(self) -> tuple[Waypoint, ...]:
        """All waypoints of the current path."""
        return task.waypoints if (task := self.task) else ()  # another thread reads this

    @property
    def waypoint(self) -> Waypoint | None:
        """The waypoint that the robot drives to."""
        return self.task.waypoint if self.task and self.task.waypoints else None

    @property
    def recoveries(self) -> int:
        """How often a path was planned again because the path was blocked or the local navigator failed."""
        return self.task.recoveries if self.task else 0

    @property
    def _missing(self) -> str:
        """A configured layer that has not been received yet, or ""."""
        return next((layer.topic for layer in self.settings.obstacles if layer.topic not in self._layers), "")

    def remaining(self, pose: Pose) -> float:
        """Return the meters to the goal, or to the link at which the robot leaves this map."""
        task = self.task
        if task is None:
            return 0.0
        return length(task.line(pose)) if task.waypoints else pose.distance(task.goal.pose)

    def use_map(self, ground: Ground | None) -> None:
        """Plan on another map from now on, or on a new version of this map."""
        before, self.ground = self.ground, ground
        self._forget_clutter()
        task = self.task
        if task is not None and ground is not None and not task.goal.map_name:
            task.set_map(ground.name)  # the goal arrived before the map
        if task is None or task.replan_reason:
            return
        if ground is None:
            if task.arrived_at is None:  # at a link, the robot waits for another map, even if it takes a while
                task.replan_reason = "the map was removed"
        elif before is None or before.name != ground.name:
            task.replan_reason = f"the map changed to {ground.name}"
        elif ground.closed or (task.arrived_at is None and _closes(ground, task, self._jumps.pose)):
            task.replan_reason = "the map has changed"

    def goal(
        self,
        pose: Pose,  # on the map
        map_name: str = "",  # empty for the current map
        constraints: Constraints | None = None,  # override the settings
        *,
        now: float = 0.0,  # seconds
        then: Sequence[MapPlace] = (),  # further goals, in sequence
    ) -> None:
        """Drive to this goal instead of the current one."""
        current_map = self.ground.name if self.ground else ""
        further = tuple(replace(place, map_name=place.map_name or current_map) for place in then)
        self.task = DriveTask(MapPlace(map_name or current_map, pose), constraints or Constraints(), now, further)
        self._paused_until = -math.inf
        self.status = PlannerStatus(State.THINKING, self.task.replan_reason)

    def cancel(self, reason: str = "canceled") -> None:
        """Drop the goal; the next step stops the robot. This clears the status of the previous goal."""
        if self.task is not None:
            self.task = None
            self._halting = True
        self.status = PlannerStatus(State.IDLE, reason)

    def brake(self, task: DriveTask) -> None:
        """Send no further waypoint of this goal, not even from a plan in progress.

        Safe from any thread: planning on a large map takes a second, but a robot has to stop at once. The caller then
        calls `cancel` or `pause` on the planner's thread.
        """
        self._braked = task

    def pause(self, now: float, seconds: float = math.inf) -> None:
        """Stop for ``seconds``, or until `resume` if that is not above 0."""
        if self.task is not None:
            self._halting, self._braked = True, None
            self._paused_until = now + seconds if seconds > 0 else math.inf
            self.task.replan_reason = "resumed"
            self.status = PlannerStatus(State.PAUSED, "paused")

    def resume(self) -> None:
        """Drive on, even if the local navigator paused itself, as RobotGoto does in a deadlock."""
        self._paused_until = -math.inf
        if self.task is not None and self.status.state is State.PAUSED:
            self.task.replan_reason, self.task.not_before = "resumed", -math.inf

    def recompute(self) -> None:
        """Plan a new path to the goal."""
        if self.task is not None:
            self.task.replan_reason, self.task.not_before = "a new path was requested", -math.inf

    def scan(self, now: float, laser: Pose, scan: LaserScan) -> None:
        """Add a laser scan to the obstacles; `laser` is the laser's pose on the map, `now` in seconds."""
        if self.clutter is not None and self.task is not None:
            farthest = min(self.settings.obstacle_distance, scan.farthest)
            self.clutter.see(laser, clean_ranges(scan), scan.first, scan.step, farthest)
            self.clutter.fade(now)

    def layer(self, topic: str, places: Places) -> None:
        """Plan around a layer's points, (n, 2) meters on the map; they replace the layer's previous points."""
        self._layers[topic] = places
        if self.clutter is None or self.ground is None:
            return
        self.clutter.layers(list(self._layers.values()))
        task = self.task
        if task is None or not task.waypoints or task.replan_reason or task.arrived_at is not None:
            return
        if blocked(self.ground, self.clutter.closed_by_layers, task.line(self._jumps.pose)):
            task.replan_reason, task.not_before = f"{topic} has changed", -math.inf

    def _forget_clutter(self) -> None:
        ground, layers = self.ground, list(self._layers.values())
        self.clutter = Clutter(ground, self.settings.obstacle_memory, layers) if ground else None

    def step(self, now: float, pose: Pose | None, local: LocalNavigator, lost: str = "") -> PlannerStatus:
        """Run one step of the planner; `now` in seconds never decreases.

        ``pose`` is the robot's pose on the map; if it is None, ``lost`` is the reason.
        """
        if self._halting:
            self._halting = False
            local.cancel()
        task = self.task
        if task is None or task is self._braked or now < self._paused_until:
            return self.status
        try:
            if pose is None:
                self._wait_for_pose(task, now, local, lost)
            else:
                self._go(task, now, pose, local)
        except PlanError as err:
            self._end(local, PlannerStatus(State.ABORTED, task.numbered(str(err)), err.fault))
        return self.status

    def _go(self, task: DriveTask, now: float, pose: Pose, local: LocalNavigator) -> None:
        jump = self._jumps.add(now, pose, _JUMP)
        if jump and not task.replan_reason:
            task.replan_reason = jump
        if jump and self.ground is not None:
            # obstacles were seen from a wrong pose, so their stored positions are wrong
            self._forget_clutter()
        task.pose_lost_since = None
        if not self.silent:
            task.layer_silent_since = None
        if task.navigator_lost_since is not None:
            self._wait_for_navigator(task, now, local)
        elif self.silent and (task.replan_reason or task.arrived_at is None):
            self._wait_for_layer(task, now, local)
        elif task.replan_reason and self.ground is None and not task.driven:
            self._wait(task, now - task.since, "waiting for a map", Fault.NO_MAP)
        elif task.replan_reason and (missing := self._missing) and not task.driven:
            self._wait(task, now - task.since, f"waiting for layer {missing}", Fault.NO_MAP)
        elif task.replan_reason:
            if now >= task.not_before:
                self._plan(task, now, pose, local)
        elif task.arrived_at is not None:
            self._wait_for_map(task, now)
        else:
            self._drive(task, now, pose, local)

    def _plan(self, task: DriveTask, now: float, pose: Pose, local: LocalNavigator) -> None:
        """Plan a path and start on it; stop and wait if obstacles of the laser or a layer block every path."""
        if not self._is_at_link(task, now, pose):
            return
        try:
            path = self._path(task, pose) if task.attempts else self._first_path(task, pose)
        except PlanError as err:
            if not err.passing:
                raise
            self._wait_for_path(task, now, local, str(err))
            return
        task.replan_reason, task.all_blocked_since = "", None
        self._set_out(task, now, pose, local, path)

    def _first_path(self, task: DriveTask, pose: Pose) -> PlannedPath:
        """Return the path around the laser's obstacles if it exists, unless a path through them is `_DETOUR` shorter.

        Such obstacles may have moved away by the time the robot gets there.
        """
        short = self._path(task, pose, around=False)
        try:
            around = self._path(task, pose)
        except PlanError as err:
            if not err.passing:
                raise
            return short
        return around if around.length <= short.length + _DETOUR else short

    def _path(self, task: DriveTask, pose: Pose, *, around: bool = True) -> PlannedPath:
        """Plan a path on the map, around the layers' obstacles and, with ``around``, around the laser's."""
        ground, clutter = self.ground, self.clutter
        if ground is None or clutter is None:
            raise PlanError(Fault.NO_MAP, "no map to plan on")
        try:
            task.leg = leg(self._atlas, ground, pose, task.goal)
        except PlanError as err:
            if task.driven and task.goal.map_name != ground.name:
                raise PlanError(Fault.MAP_CHANGED, f"the map changed to {ground.name} while driving: {err}") from None
            raise
        constraints = task.constraints if task.leg.onto is None else None
        around = around and bool(len(clutter.cells))
        weights = clutter.weights(seen=around) if around or len(clutter.fixed) else None
        path = plan_path(ground, pose, task.leg.end.pose, self.settings, constraints, weights)
        return passing(path, self.settings) if task.passes else path

    def _set_out(self, task: DriveTask, now: float, pose: Pose, local: LocalNavigator, path: PlannedPath) -> None:
        task.waypoints, task.index, task.note = path.waypoints, 0, path.note
        task.arrived_at = task.path_blocked_since = None
        self._watched = now
        if task.last and task.waypoint.is_reached(pose):
            if not local.state.ended:  # the local navigator still drives to the previous goal
                local.cancel()
            self._arrive(task, now, local)
            return
        self._send(task, local)

    def _send(self, task: DriveTask, local: LocalNavigator) -> None:
        if task is self._braked:
            return
        self.status = PlannerStatus(State.MOVING, task.note)
        local.send(task.waypoint.pose, task.waypoint.constraints)

    def _drive(self, task: DriveTask, now: float, pose: Pose, local: LocalNavigator) -> None:
        state, ground, clutter = local.state, self.ground, self.clutter
        waits = _waits_for_obstacle(local)
        task.driven = task.driven or state is not State.ERROR
        if state is State.REACHED or ((task.passes or not task.last) and task.waypoint.is_passed(pose)):
            if task.last:
                self._arrive(task, now, local)
            else:
                task.index += 1
                self._send(task, local)
        elif state in (State.FAILING, State.ABORTED):
            reason = local.reason or "the local navigator failed"
            if local.fault.anywhere:
                raise PlanError(local.fault, reason)
            self._recover(task, now, pose, reason)
        elif state is State.IDLE:
            reason = local.reason or "another client stopped it"
            raise PlanError(Fault.OTHER, f"the local navigator stopped: {reason}")
        elif state is State.ERROR:
            self._wait_for_navigator(task, now, local)
        elif ground and clutter and not self.blind and task.can_skip(ground, clutter, pose, waits=waits):
            task.index += 1
            self._send(task, local)
        else:
            self.status = PlannerStatus(state, local.reason or task.note, local.fault)
            self._count(task, pose)
            if now - self._watched >= _WATCH:
                self._watched = now
                self._watch(task, now, pose, local)

    def _count(self, task: DriveTask, pose: Pose) -> None:
        """Reset the count of attempts if the robot has come nearer to the goal."""
        left = self.remaining(pose)
        if left < task.best - _NEARER:
            task.best, task.attempts = left, 0

    def _watch(self, task: DriveTask, now: float, pose: Pose, local: LocalNavigator) -> None:
        """Replan if a wall is between the robot and its waypoint; try another path if obstacles block this one."""
        ground, clutter = self.ground, self.clutter
        assert ground is not None
        assert clutter is not None
        if not is_straight(ground, pose, task.waypoint.pose):
            task.replan_reason = "a wall is between the robot and its waypoint"
            return
        if _waits_for_obstacle(local) and task.passes_wall(ground, pose):
            task.replan_reason = "a wall is near the robot's line to its waypoint"
            return
        line = task.line(pose)
        if not (len(clutter.cells) or len(clutter.fixed)) or not _is_path_blocked(ground, clutter, line, local):
            task.path_blocked_since = None
            return
        task.path_blocked_since = now if task.path_blocked_since is None else task.path_blocked_since
        if (
            task.waypoint.waits_for_obstacles
            or now - task.path_blocked_since < self.settings.patience
            or task.attempts >= self.settings.recoveries
        ):
            return
        try:
            alternative = self._path(task, pose)
        except PlanError as err:
            if not err.passing:
                raise
            task.path_blocked_since = now  # this is the only path, so the local navigator waits
            return
        longer = alternative.length - self.remaining(pose)
        if now - task.path_blocked_since < min(_PATIENCE_PER_METER * longer, _LONGEST_PATIENCE):
            return  # a person in a corridor moves away sooner than the robot drives a long detour
        task.attempts += 1
        task.recoveries += 1
        self._set_out(task, now, pose, local, alternative)

    def _recover(self, task: DriveTask, now: float, pose: Pose, reason: str) -> None:
        """Handle a failure of the local navigator: plan again after a delay, at most ``recoveries`` times in a row."""
        self._count(task, pose)
        if task.attempts >= self.settings.recoveries:
            tried = f"; aborted after {task.attempts} more attempts" if task.attempts else ""
            raise PlanError(Fault.BLOCKED, reason + tried)
        task.replan_reason, task.not_before = reason, now + 2.0**task.attempts - 0.5
        task.attempts += 1
        task.recoveries += 1
        self.status = PlannerStatus(State.WAITING, f"{reason}; trying again", Fault.BLOCKED)

    def _arrive(self, task: DriveTask, now: float, local: LocalNavigator) -> None:
        assert task.leg is not None
        if task.leg.onto is None and task.further:
            task.goal, *further = task.further
            task.further, task.replan_reason, task.waypoints, task.best = tuple(further), "the next goal", (), math.inf
            task.passed += 1
        elif task.leg.onto is None:
            self._end(local, PlannerStatus(State.REACHED, "goal reached"))
        else:
            self._wait_at_link(task, task.leg, now)

    def _wait_at_link(self, task: DriveTask, part: Leg, now: float) -> None:
        assert part.onto is not None
        task.arrived_at = now
        name = part.end.name or f"({part.end.pose.x:.2f}, {part.end.pose.y:.2f})"
        self.status = PlannerStatus(State.WAITING, f"at {name}: waiting for the map to change to {part.onto.map_name}")

    def _wait_for_map(self, task: DriveTask, now: float) -> None:
        assert task.arrived_at is not None
        if now - task.arrived_at > self.settings.max_map_waiting_time:
            raise PlanError(
                Fault.MAP_CHANGED, f"the map has not changed for {now - task.arrived_at:.0f} s; {_expected_map(task)}"
            )

    def _is_at_link(self, task: DriveTask, now: float, pose: Pose) -> bool:
        """Return whether a robot that has changed maps is localized near the link's end; if not, report waiting."""
        if task.arrived_at is None or task.leg is None or task.leg.onto is None or self.ground is None:
            return True
        onto = task.leg.onto
        if onto.map_name != self.ground.name or pose.distance(onto.pose) <= _AT_LINK:
            return True
        self._wait_for_map(task, now)
        self.status = PlannerStatus(
            State.WAITING, f"on the map {onto.map_name}: waiting to be localized near {onto.name}"
        )
        return False

    def _wait_for_path(self, task: DriveTask, now: float, local: LocalNavigator, reason: str) -> None:
        if task.all_blocked_since is None:
            task.all_blocked_since = now
            local.cancel()
        if now - task.all_blocked_since > self.settings.max_waiting_time:
            raise PlanError(Fault.BLOCKED, f"{reason}, for {now - task.all_blocked_since:.0f} s now")
        task.not_before = now + _AGAIN
        self.status = PlannerStatus(State.WAITING, reason, Fault.BLOCKED)

    def _wait_for_pose(self, task: DriveTask, now: float, local: LocalNavigator, reason: str) -> None:
        reason = f"the robot's pose is unknown: {reason}" if reason else "the robot's pose is unknown"
        fault = Fault.NOT_LOCALIZED
        if self.blind:  # without a laser, localization is lost too
            reason, fault = self.blind, Fault.NO_LASER
        task.pose_lost_since = now if task.pose_lost_since is None else task.pose_lost_since
        lost = now - task.pose_lost_since
        if lost >= _GLITCH and not task.replan_reason:
            local.cancel()
            task.replan_reason, task.not_before = "the robot's pose is known again", -math.inf
        self._wait(task, lost, reason, fault, reported=bool(task.replan_reason))

    def _wait_for_layer(self, task: DriveTask, now: float, local: LocalNavigator) -> None:
        """Stop, because the obstacles that the silent layer would show are unknown."""
        if task.layer_silent_since is None:
            task.layer_silent_since, task.replan_reason = now, task.replan_reason or "the layer is received again"
            local.cancel()
        self._wait(task, now - task.layer_silent_since, self.silent, Fault.NO_LASER)

    def _wait(self, task: DriveTask, waited: float, reason: str, fault: Fault, *, reported: bool = True) -> None:
        """Report what is missing, and abort the goal if it stays missing too long."""
        if waited > self.settings.max_waiting_time:
            again = "" if task.driven else f", for {waited:.0f} s now: send the goal again once that has changed"
            raise PlanError(fault, reason + again)
        if reported:
            self.status = PlannerStatus(State.WAITING if task.driven else State.PREPARING, reason, fault)

    def _wait_for_navigator(self, task: DriveTask, now: float, local: LocalNavigator) -> None:
        if task.navigator_lost_since is None:
            task.navigator_lost_since = now
        if local.state is not State.ERROR:
            task.navigator_lost_since, task.replan_reason, task.not_before = (
                None,
                "the local navigator is back",
                -math.inf,
            )
            return
        reason = local.reason or "no local navigator"
        self._wait(task, now - task.navigator_lost_since, reason, Fault.NO_NAVIGATOR)

    def _end(self, local: LocalNavigator, status: PlannerStatus) -> None:
        if status.state is not State.REACHED:
            local.cancel()
        self.task, self.status = None, status


def _closes(ground: Ground, task: DriveTask, pose: Pose | None) -> bool:
    """Whether the path enters closed cells of a map, or ends in them; a robot that is in closed cells leaves them."""
    line, closed = task.line(pose), ground.weights == 0
    return blocked(ground, closed, line) or blocked(ground, closed, line[-1:], inside=True)


def _waits_for_obstacle(local: LocalNavigator) -> bool:
    """Whether the local navigator stands in front of an obstacle."""
    return local.state is State.WAITING and local.fault is Fault.BLOCKED


def _is_path_blocked(ground: Ground, clutter: Clutter, line: Places, local: LocalNavigator) -> bool:
    """Whether obstacles are on the path, or next to it if the local navigator already waits for an obstacle."""
    ahead = cut(line, _AHEAD)
    if _waits_for_obstacle(local):
        return blocked(ground, clutter.closed(), ahead, inside=True)
    return blocked(ground, clutter.struck(), ahead)


def _expected_map(task: DriveTask) -> str:
    assert task.leg is not None
    return f"expected {task.leg.onto.map_name}" if task.leg.onto else "no other map expected"
