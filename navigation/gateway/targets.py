"""The targets of goals, given as poses or as names of places in the store."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bridge.config.sections.navigation import OURS
from bridge.modules.host import Host
from bridge.stores.entry import StoreError
from bridge.stores.kinds import AREA, LOCATION, MAP
from bridge.stores.store import Store
from navigation.constraints import PREFIX, Constraints
from navigation.goals import MOST_POSES
from navigation.maps.grid import from_grid, yaw_of
from navigation.messages import pose_message
from navigation.pose import Pose, check_rotation
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D

_NO_STAMP = {"sec": 0, "nanosec": 0}


@dataclass(frozen=True)
class Target:
    """A pose to drive to."""

    pose: Pose  #: meters and rad; a theta of NaN means any heading
    frame: str  #: the frame of the pose; for a place on another map, the name of that map in the store
    tree: str = ""  #: the client's ``behavior_tree``

    def goal(self, planner: str, robot: Pose | None) -> dict[str, Any]:
        """Return the goal for a planner, with a stamp of 0, because two machines' clocks may differ.

        A hosted planner gets Midspan's constraints, any other planner the name of a behavior tree; a text of the other
        kind is dropped. A theta of NaN becomes the direction from the robot to the target, or 0 if the robot's pose is
        unknown; a hosted planner without constraints then also gets the constraint that the heading does not matter.
        """
        ours, tree = planner in OURS, self.tree
        if tree.startswith(PREFIX) != ours:
            tree = ""
        if math.isnan(self.pose.theta) and ours and not tree:
            tree = Constraints(heading=False).to_text()
        return {"pose": self.stamped(robot), "behavior_tree": tree}

    def stamped(self, robot: Pose | None = None) -> dict[str, Any]:
        """Return the target as a ``geometry_msgs/PoseStamped``."""
        pose = self.pose
        if math.isnan(pose.theta) and robot is not None:
            pose = pose._replace(theta=math.atan2(pose.y - robot.y, pose.x - robot.x))
        return {"header": {"stamp": _NO_STAMP, "frame_id": self.frame}, "pose": pose_message(pose)}


def goal_through(targets: Sequence[Target], planner: str, robot: Pose | None) -> dict[str, Any]:
    """Return the goal of `NavigateThroughPoses` for targets that differ only in their poses."""
    goals = [target.goal(planner, robot) for target in targets]
    return {"poses": [goal["pose"] for goal in goals], "behavior_tree": goals[-1]["behavior_tree"]}


class TargetError(ValueError):
    """A goal that no planner could follow; the text gives the reason."""


def target_of(message: Mapping[str, Any], tree: str = "") -> Target:
    """Return the target of a ``geometry_msgs/PoseStamped``; raises `TargetError` if it is invalid."""
    frame = str(message["header"]["frame_id"]).lstrip("/")
    position, orientation = message["pose"]["position"], message["pose"]["orientation"]
    if not frame:
        raise TargetError("the goal's frame is empty; for a goal on the map, set the map's frame, by default 'map'")
    if not all(map(math.isfinite, (*position.values(), *orientation.values()))):
        raise TargetError("the goal's pose is not finite")
    try:
        check_rotation(orientation, "the goal's")
    except ValueError as err:
        raise TargetError(str(err)) from None
    return Target(Pose(float(position["x"]), float(position["y"]), yaw_of(orientation)), frame, tree)


def targets_of(goal: Mapping[str, Any]) -> list[Target]:
    """Return the targets of a ``NavigateToPose`` or ``NavigateThroughPoses`` goal; raises `TargetError`."""
    poses = goal["poses"] if "poses" in goal else [goal["pose"]]
    if not 0 < len(poses) <= MOST_POSES:
        raise TargetError(f"the goal has {len(poses)} poses; send 1 to {MOST_POSES}")
    return [target_of(pose, goal["behavior_tree"]) for pose in poses]


_ANY = math.nan


class StoredPlaces:
    """The store's places as goals.

    ``waits`` returns whether the current planner accepts goals whose frame is the name of a stored map, and does not
    drive before a map is in use.
    """

    def __init__(self, host: Host, frame: str, waits: Callable[[], bool] = lambda: False) -> None:
        self._host, self._frame, self._waits = host, frame, waits

    @property
    def store(self) -> Store | None:
        """The store; None if it is disabled or cannot be used."""
        try:
            return self._host.store
        except StoreError:
            return None

    @property
    def current(self) -> str:
        """The name of the map in use, "" for none."""
        return "" if self.store is None else self.store.current_map()

    def find(self, name: str) -> Target:
        """Return a location's pose, or a point in an area, with a theta of NaN.

        Raises `LookupError` if the name is unknown, the area is invalid, the place's map is not stored, or the store is
        disabled or cannot be used.
        """
        try:
            store = self._host.store
        except StoreError as err:
            raise LookupError(f"stored places are unavailable: {err}") from None
        location = store.get(LOCATION, name)
        if location is not None:
            return self.known(location)
        area = store.get(AREA, name)
        if area is None:
            known = ", ".join([*store.names(LOCATION), *store.names(AREA)][:20]) or "none"
            raise LookupError(f"unknown location or area {name!r}; known: {known}")
        middle = area.getCentroid()
        if middle is None:
            raise LookupError(f"area {name!r} is invalid; it must have a map and at least three points")
        inside = middle if area.contains(middle.x, middle.y) else area.getRandomLocation() or middle
        inside.theta = _ANY
        return self.known(inside)

    def target(self, place: Map2DLocation) -> Target:
        """Return a goal at a place; if the place is on another map, the goal's frame is that map's name.

        If no map is in use, the frame is the name of the place's map only if the planner waits for a map (``waits``)
        and the store has that map; otherwise it is the map's frame.
        """
        known = self.current or (self._waits() and self.store is not None and place.map_id in self.store.names(MAP))
        elsewhere = place.map_id and known and place.map_id not in (self.current, self._frame)
        frame = place.map_id if elsewhere else self._frame
        return Target(Pose(place.x, place.y, math.radians(place.theta)), frame)

    def known(self, place: Map2DLocation) -> Target:
        """Return a goal at a place.

        Raises `LookupError` if a map is in use, the place is on another map, and the store does not have that map.
        """
        target, store = self.target(place), self.store
        if target.frame != self._frame and store is not None and target.frame not in (maps := store.names(MAP)):
            stored = ", ".join(maps[:20]) or "none"
            raise LookupError(f"the place is on map {target.frame!r}, which is not stored; stored maps: {stored}")
        return target

    def location(self, message: Mapping[str, Any] | Target) -> Map2DLocation:
        """Return a ``geometry_msgs/PoseStamped``, or a target, as a place on a map."""
        if isinstance(message, Target):
            frame, pose = message.frame, message.pose
        else:
            position, frame = message["pose"]["position"], str(message["header"]["frame_id"])
            pose = Pose(position["x"], position["y"], yaw_of(message["pose"]["orientation"]))
        map_id = self.current or frame if frame in ("", self._frame) else frame
        return Map2DLocation(map_id, float(pose.x), float(pose.y), math.degrees(pose.theta))

    def map(self) -> MapGrid2D | None:
        """Return the map in use."""
        store = self.store
        return None if store is None or not self.current else store.get(MAP, self.current)

    def grid(self, message: Mapping[str, Any] | None) -> MapGrid2D | None:
        """Return a ``nav_msgs/OccupancyGrid`` as a YARP map."""
        return None if message is None else from_grid(message, self.current or "map")
