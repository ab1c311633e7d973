"""RobotPathPlanner without a hub: plans, hands waypoints to a local navigator, and plans anew where that is needed.

What robotology/navigation's ``robotPathPlannerDev`` does, driven by time as an argument: a caller steps it some 5 to 50
times a second.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bridge.config.sections.planners import RobotPathPlannerSection
from bridge.messages.scan import Turn
from navigation.constraints import Constraints
from navigation.goals import MapPlace
from navigation.pose import Pose
from navigation.robot_path_planner.atlas import Atlas, Leg, leg
from navigation.robot_path_planner.ground import Clutter, Ground
from navigation.robot_path_planner.navigators import LocalNavigator
from navigation.robot_path_planner.way import (
    DriveTask,
    JumpDetector,
    Places,
    Way,
    Waypoint,
    blocked,
    cut,
    is_straight,
    length,
    way,
)
from navigation.scan import believed
from navigation.status import Fault, PlanError, PlannerStatus, State

_JUMP = 0.5  # metres that localisation moves the robot at once, or 30 degrees, after which another way is planned
_WATCH = 0.5  # seconds from one look at the way ahead to the next
_AHEAD = 5.0  # metres of the way that are looked at
_AGAIN = 2.0  # seconds after which a way is looked for again where there was none
_GLITCH = 0.3  # seconds for which a missing pose does not matter
_NEARER = 0.5  # metres that the robot has to come nearer for its attempts to be counted anew
_PATIENCE_PER_METRE, _LONGEST_PATIENCE = 2.0, 20.0
"""Seconds that the way is waited for to become free again, for each metre by which another one is longer."""
_DETOUR = 3.0
"""Metres by which a way round what the laser sees may be longer for it to be taken before anything has stopped."""
_AT_LINK = 3.0  # metres from a link's end within which a robot that has changed maps is believed to be there


class PathPlanner:
    """Drives one robot to one goal at a time."""

    def __init__(self, settings: RobotPathPlannerSection | None = None, atlas: Atlas | None = None) -> None:
        self.settings = settings or RobotPathPlannerSection()  # may be replaced; what is planned then goes by it
        self._atlas = atlas or Atlas()
        self.ground: Ground | None = None
        self.clutter: Clutter | None = None
        self.task: DriveTask | None = None
        self._halting = False
        self._braked: DriveTask | None = None
        self._paused_until = -math.inf
        self._jumps = JumpDetector()
        self._watched = -math.inf
        self.status = PlannerStatus()  # as it is now
        self._layers: dict[str, Places] = {}
        self.blind = ""  # why the laser says nothing, "" where it does; whoever gives scans sets it
        self.silent = ""  # which layer says nothing any more, "" where none does; whoever gives layers sets it

    @property
    def active(self) -> bool:
        """Whether there is a goal."""
        return self.task is not None

    @property
    def target(self) -> MapPlace | None:
        """The goal."""
        return self.task.goal if self.task else None

    @property
    def waypoints(self) -> tuple[Waypoint, ...]:
        """All of the way at hand."""
        return self.task.waypoints if self.task else ()

    @property
    def waypoint(self) -> Waypoint | None:
        """The one that is driven to."""
        return self.task.waypoint if self.task and self.task.waypoints else None

    @property
    def recoveries(self) -> int:
        """How often the way was blocked and another was tried."""
        return self.task.recoveries if self.task else 0

    @property
    def _missing(self) -> str:
        """A layer of the settings that has not come yet."""
        return next((one.topic for one in self.settings.obstacles if one.topic not in self._layers), "")

    def remaining(self, pose: Pose) -> float:
        """Metres to the goal, or to the link from which the way goes on on another map."""
        task = self.task
        if task is None:
            return 0.0
        return length(self._ahead(pose)) if task.waypoints else pose.distance(task.goal.pose)

    def use_map(self, ground: Ground | None) -> None:
        """Plan on another map from now on, or on what has become of this one."""
        before, self.ground = self.ground, ground
        self._forget_clutter()
        task = self.task
        if task is not None and ground is not None and not task.goal.map_name:
            task.is_on(ground.name)  # it came before the map
        if task is None or task.due:
            return
        if ground is None:
            if task.arrived is None:  # at a link another map is waited for, whatever comes between
                task.due = "the map is gone"
        elif before is None or before.name != ground.name:
            task.due = f"the map is {ground.name} now"
        elif task.arrived is None and blocked(ground, ground.weights == 0, self._line(task)):
            task.due = "the map has changed"

    def goal(
        self,
        pose: Pose,  # on the map
        map_name: str = "",  # which; empty for the map at hand
        constraints: Constraints | None = None,  # what holds instead of the settings
        *,
        now: float = 0.0,  # seconds
        then: Sequence[MapPlace] = (),  # where to drive on to from there, one after the other
    ) -> None:
        """Drive there, instead of where it is driving."""
        here = self.ground.name if self.ground else ""
        further = tuple(replace(place, map_name=place.map_name or here) for place in then)
        self.task = DriveTask(MapPlace(map_name or here, pose), constraints or Constraints(), now, further)
        self._paused_until = -math.inf
        self.status = PlannerStatus(State.THINKING, self.task.due)

    def cancel(self, reason: str = "cancelled") -> None:
        """Give the goal up; the robot stands still from the next step on. How the last one ended is forgotten."""
        if self.task is not None:
            self.task = None
            self._halting = True
        self.status = PlannerStatus(State.IDLE, reason)

    def brake(self, task: DriveTask) -> None:
        """Send no waypoint of this goal any more, not even that of a plan under way.

        On any thread: planning on a large map takes a second, and a robot is to stop at once. `cancel` or `pause`
        follows on the planner's own thread.
        """
        self._braked = task

    def pause(self, now: float, seconds: float = math.inf) -> None:
        """Stand still for some seconds, or until `resume`."""
        if self.task is not None:
            self._halting, self._braked = True, None
            self._paused_until = now + seconds if seconds > 0 else math.inf
            self.task.due = "it goes on"
            self.status = PlannerStatus(State.PAUSED, "paused")

    def resume(self) -> None:
        """Go on, also if the local navigator has paused by itself, as RobotGoto in a deadlock."""
        self._paused_until = -math.inf
        if self.task is not None and self.status.state is State.PAUSED:
            self.task.due, self.task.not_before = "it goes on", -math.inf

    def recompute(self) -> None:
        """Look for a way anew."""
        if self.task is not None:
            self.task.due, self.task.not_before = "it was asked for", -math.inf

    def scan(self, now: float, laser: Pose, scan: Turn) -> None:
        """See what stands in the way: a turn of a laser at a pose on the map; seconds."""
        if self.clutter is not None and self.task is not None:
            farthest = min(self.settings.obstacle_distance, scan.farthest)
            self.clutter.see(laser, believed(scan), scan.first, scan.step, farthest)
            self.clutter.forget(now)

    def layer(self, topic: str, places: Places) -> None:
        """Plan around a layer's places from now on, (n, 2) metres on the map, in place of what it had."""
        self._layers[topic] = places
        if self.clutter is None or self.ground is None:
            return
        self.clutter.layers(list(self._layers.values()))
        task = self.task
        if task is None or not task.waypoints or task.due or task.arrived is not None:
            return
        if blocked(self.ground, self.clutter.closed_by_layers, self._line(task)):
            task.due, task.not_before = f"{topic} has changed", -math.inf

    def _forget_clutter(self) -> None:
        ground, layers = self.ground, list(self._layers.values())
        self.clutter = Clutter(ground, self.settings.obstacle_memory, layers) if ground else None

    def step(self, now: float, pose: Pose | None, local: LocalNavigator, lost: str = "") -> PlannerStatus:
        """Take one step, at seconds that never go back, with the one who drives to waypoints.

        The pose is the robot's on the map; None where it is not known, for the reason ``lost``.
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
            self._end(local, PlannerStatus(State.ABORTED, str(err), err.fault))
        return self.status

    def _go(self, task: DriveTask, now: float, pose: Pose, local: LocalNavigator) -> None:
        jump = self._jumps.add(now, pose, _JUMP)
        if jump and not task.due:
            task.due = jump
        if jump and self.ground is not None:
            # what was seen from where the robot is not stands somewhere else
            self._forget_clutter()
        task.lost_since = None
        if not self.silent:
            task.silent_since = None
        if task.gone_since is not None:
            self._wait_for_navigator(task, now, local)
        elif self.silent and (task.due or task.arrived is None):
            self._wait_for_layer(task, now, local)
        elif task.due and self.ground is None and not task.driven:
            self._wait(task, now - task.since, "there is no map to plan on yet", Fault.NO_MAP)
        elif task.due and (missing := self._missing) and not task.driven:
            self._wait(task, now - task.since, f"the layer {missing} has not come yet", Fault.NO_MAP)
        elif task.due:
            if now >= task.not_before:
                self._plan(task, now, pose, local)
        elif task.arrived is not None:
            self._wait_for_map(task, now)
        else:
            self._drive(task, now, pose, local)

    def _plan(self, task: DriveTask, now: float, pose: Pose, local: LocalNavigator) -> None:
        """Find a way and set out on it; where the laser closes all, stand and wait."""
        if not self._is_at_link(task, now, pose):
            return
        try:
            found = self._way(task, pose) if task.attempts else self._first_way(task, pose)
        except PlanError as err:
            if not err.passing:
                raise
            self._wait_for_way(task, now, local, str(err))
            return
        task.due, task.blocked_since = "", None
        self._set_out(task, now, pose, local, found)

    def _first_way(self, task: DriveTask, pose: Pose) -> Way:
        """The way round what the laser sees, where that is not much longer: it may be gone when the robot is there."""
        short = self._way(task, pose, around=False)
        try:
            around = self._way(task, pose)
        except PlanError as err:
            if not err.passing:
                raise
            return short
        return around if around.length <= short.length + _DETOUR else short

    def _way(self, task: DriveTask, pose: Pose, *, around: bool = True) -> Way:
        """A way by the map, and around what the laser sees."""
        ground, clutter = self.ground, self.clutter
        if ground is None or clutter is None:
            raise PlanError(Fault.NO_MAP, "there is no map to plan on")
        try:
            task.leg = leg(self._atlas, ground, pose, task.goal)
        except PlanError as err:
            if task.driven and task.goal.map_name != ground.name:
                raise PlanError(Fault.MAP_CHANGED, f"the map was changed to {ground.name} on the way: {err}") from None
            raise
        wanted = task.wanted if task.leg.onto is None else None
        around = around and bool(len(clutter.cells))
        weights = clutter.weights(seen=around) if around or len(clutter.fixed) else None
        return way(ground, pose, task.leg.end.pose, self.settings, wanted, weights)

    def _set_out(self, task: DriveTask, now: float, pose: Pose, local: LocalNavigator, found: Way) -> None:
        task.waypoints, task.at, task.note = found.waypoints, 0, found.note
        task.arrived = task.closed_since = None
        self._watched = now
        if task.last and task.waypoint.is_there(pose):
            if not local.state.ended:  # it drives to where the robot was sent before
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
        state = local.state
        task.driven = task.driven or state is not State.ERROR
        if state is State.REACHED or (not task.last and task.waypoint.is_passed(pose)):
            if task.last:
                self._arrive(task, now, local)
            else:
                task.at += 1
                self._send(task, local)
        elif state in (State.FAILING, State.ABORTED):
            why = local.reason or "the local navigator gave up"
            if local.fault.anywhere:
                raise PlanError(local.fault, why)
            self._recover(task, now, pose, why)
        elif state is State.IDLE:
            why = local.reason or "somebody else stopped it"
            raise PlanError(Fault.OTHER, f"the local navigator drives no more: {why}")
        elif state is State.ERROR:
            self._wait_for_navigator(task, now, local)
        else:
            self.status = PlannerStatus(state, local.reason or task.note, local.fault)
            self._count(task, pose)
            if now - self._watched >= _WATCH:
                self._watched = now
                self._watch(task, now, pose, local)

    def _count(self, task: DriveTask, pose: Pose) -> None:
        """A robot that comes nearer has all its attempts again."""
        left = self.remaining(pose)
        if left < task.best - _NEARER:
            task.best, task.attempts = left, 0

    def _watch(self, task: DriveTask, now: float, pose: Pose, local: LocalNavigator) -> None:
        """Look for another way where a wall or what the laser sees has come between."""
        ground, clutter = self.ground, self.clutter
        assert ground is not None
        assert clutter is not None
        if not is_straight(ground, pose, task.waypoint.pose):
            task.due = "the way is not straight any more"
            return
        if not (len(clutter.cells) or len(clutter.fixed)) or not blocked(
            ground, clutter.struck(), cut(self._ahead(pose), _AHEAD)
        ):
            task.closed_since = None
            return
        task.closed_since = now if task.closed_since is None else task.closed_since
        if (
            task.waypoint.waits
            or now - task.closed_since < self.settings.patience
            or task.attempts >= self.settings.recoveries
        ):
            return
        try:
            found = self._way(task, pose)
        except PlanError as err:
            if not err.passing:
                raise
            task.closed_since = now  # there is no other; who drives waits for it
            return
        longer = found.length - self.remaining(pose)
        if now - task.closed_since < min(_PATIENCE_PER_METRE * longer, _LONGEST_PATIENCE):
            return  # somebody in a corridor is gone sooner than a long way round is driven
        task.attempts += 1
        task.recoveries += 1
        self._set_out(task, now, pose, local, found)

    def _recover(self, task: DriveTask, now: float, pose: Pose, why: str) -> None:
        """The local navigator failed: try another way, or this one again."""
        self._count(task, pose)
        if task.attempts >= self.settings.recoveries:
            tried = f"; given up after {task.attempts} further attempts" if task.attempts else ""
            raise PlanError(Fault.BLOCKED, why + tried)
        task.due, task.not_before = why, now + 2.0**task.attempts - 0.5
        task.attempts += 1
        task.recoveries += 1
        self.status = PlannerStatus(State.WAITING, f"{why}; it is tried again", Fault.BLOCKED)

    def _arrive(self, task: DriveTask, now: float, local: LocalNavigator) -> None:
        assert task.leg is not None
        if task.leg.onto is None and task.then:
            task.goal, *further = task.then
            task.then, task.due, task.waypoints, task.best = tuple(further), "the next place", (), math.inf
        elif task.leg.onto is None:
            self._end(local, PlannerStatus(State.REACHED, "the goal is reached"))
        else:
            self._wait_at_link(task, task.leg, now)

    def _wait_at_link(self, task: DriveTask, part: Leg, now: float) -> None:
        assert part.onto is not None
        task.arrived = now
        name = part.end.name or f"({part.end.pose.x:.2f}, {part.end.pose.y:.2f})"
        self.status = PlannerStatus(State.WAITING, f"at {name}: waits to be on the map {part.onto.map_name}")

    def _wait_for_map(self, task: DriveTask, now: float) -> None:
        assert task.arrived is not None
        if now - task.arrived > self.settings.max_map_waiting_time:
            raise PlanError(
                Fault.MAP_CHANGED, f"the map has not changed for {now - task.arrived:.0f} s; was {_to(task)}"
            )

    def _is_at_link(self, task: DriveTask, now: float, pose: Pose) -> bool:
        """Whether a robot that has changed maps is known to be where its link leads; else that is waited for."""
        if task.arrived is None or task.leg is None or task.leg.onto is None or self.ground is None:
            return True
        onto = task.leg.onto
        if onto.map_name != self.ground.name or pose.distance(onto.pose) <= _AT_LINK:
            return True
        self._wait_for_map(task, now)
        self.status = PlannerStatus(
            State.WAITING, f"on the map {onto.map_name}: waits to be localised near {onto.name}"
        )
        return False

    def _wait_for_way(self, task: DriveTask, now: float, local: LocalNavigator, why: str) -> None:
        if task.blocked_since is None:
            task.blocked_since = now
            local.cancel()
        if now - task.blocked_since > self.settings.max_waiting_time:
            raise PlanError(Fault.BLOCKED, f"{why}, and has for {now - task.blocked_since:.0f} s")
        task.not_before = now + _AGAIN
        self.status = PlannerStatus(State.WAITING, why, Fault.BLOCKED)

    def _wait_for_pose(self, task: DriveTask, now: float, local: LocalNavigator, why: str) -> None:
        why = f"it is not known where the robot is: {why}" if why else "it is not known where the robot is"
        fault = Fault.NOT_LOCALIZED
        if self.blind:  # without a laser the localisation is lost too
            why, fault = self.blind, Fault.NO_LASER
        task.lost_since = now if task.lost_since is None else task.lost_since
        lost = now - task.lost_since
        if lost >= _GLITCH and not task.due:
            local.cancel()
            task.due, task.not_before = "it is known again where the robot is", -math.inf
        self._wait(task, lost, why, fault, told=bool(task.due))

    def _wait_for_layer(self, task: DriveTask, now: float, local: LocalNavigator) -> None:
        """Stand, as what has come into the way since is not known."""
        if task.silent_since is None:
            task.silent_since, task.due = now, task.due or "the layer is heard again"
            local.cancel()
        self._wait(task, now - task.silent_since, self.silent, Fault.NO_LASER)

    def _wait(self, task: DriveTask, waited: float, why: str, fault: Fault, *, told: bool = True) -> None:
        """Report what is missing, and give up the goal if it does not come in time."""
        if waited > self.settings.max_waiting_time:
            again = "" if task.driven else f", and has been so for {waited:.0f} s: ask again once it has changed"
            raise PlanError(fault, why + again)
        if told:
            self.status = PlannerStatus(State.WAITING if task.driven else State.PREPARING, why, fault)

    def _wait_for_navigator(self, task: DriveTask, now: float, local: LocalNavigator) -> None:
        if task.gone_since is None:
            task.gone_since = now
        if local.state is not State.ERROR:
            task.gone_since, task.due, task.not_before = None, "the local navigator is back", -math.inf
            return
        why = local.reason or "there is no local navigator"
        self._wait(task, now - task.gone_since, why, Fault.NO_NAVIGATOR)

    def _end(self, local: LocalNavigator, status: PlannerStatus) -> None:
        if status.state is not State.REACHED:
            local.cancel()
        self.task, self.status = None, status

    def _ahead(self, pose: Pose) -> Places:
        """(n, 2) the robot, and the waypoints that are left."""
        task = self.task
        left = task.waypoints[task.at :] if task else ()
        return np.array([(pose.x, pose.y), *((each.pose.x, each.pose.y) for each in left)])

    def _line(self, task: DriveTask) -> Places:
        """(n, 2) the waypoints that are left, and the robot where that is known."""
        line = [(each.pose.x, each.pose.y) for each in task.waypoints[task.at :]]
        if self._jumps.pose is not None:
            line.insert(0, self._jumps.pose[:2])
        return np.array(line)


def _to(task: DriveTask) -> str:
    assert task.leg is not None
    return f"to become {task.leg.onto.map_name}" if task.leg.onto else "to stay"
