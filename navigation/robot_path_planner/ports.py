"""The planner's topics and YARP ports: status, path, the map as a picture to click on, and INavigation2D."""

# ruff: noqa: N802, D102 - YARP's names, documented in its interface

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from navigation.messages import Message, pose_message
from navigation.planner_module import PlannerDevice, PlannerModule, PlannerTopics, place_of
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground
from navigation.robot_path_planner.planner import PathPlanner
from navigation.status import NO_GOAL, Fault, PlanError, PlannerStatus
from navigation.yarp import Calls, location_of
from yarp_compat.dev.inavigation2d import Navigation2DServer, NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapflag import COLORS, MapFlag, picture_of_flags
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.image import ImageRgb

_SPHERES, _LINES, _ARROW, _DELETE_ALL = 7, 4, 0, 3
_BLUE, _PINK = {"r": 0.0, "g": 0.25, "b": 0.9, "a": 1.0}, {"r": 0.8, "g": 0.0, "b": 0.5, "a": 1.0}
_REPEAT = 5.0  # seconds after which YARP's status port repeats the status, like upstream's port
_REASON_PERIOD = 1.0  # seconds between two statuses that differ only in their reason


class PathPlannerTopics(PlannerTopics):
    """Publishes the status and the path when they change, and pictures. Used only on the module's thread.

    Without a prefix, it opens no YARP ports.
    """

    def __init__(self, host: Host, frame: str, prefix: str) -> None:
        super().__init__(host, "robot_path_planner", frame)
        markers = "visualization_msgs/msg/MarkerArray"
        self._markers = host.node.publisher(f"{self._prefix}/markers", markers, LATCHED, priority="state")
        self._status_port = host.yarp.output(f"{prefix}/plannerStatus:o") if prefix else None
        self._image = host.yarp.output(f"{prefix}/map:o") if prefix else None
        self._path_shown: object = None
        self._written = self._published = -math.inf

    def publish(self, now: float, planner: PathPlanner, goal_id: bytes = NO_GOAL) -> None:
        """Publish the status and the path if they have changed."""
        status, target = planner.status, planner.target
        if self._is_news(now, status, goal_id):
            self._published = now
            self._publish_status(status, target.pose if target else None, goal_id)
            self._written = -math.inf
        if self._status_port is not None and now - self._written >= _REPEAT:
            self._written = now
            self._status_port.write([f"navigation_status_{status.state.value}"])
        if planner.waypoints is not self._path_shown:
            self._path_shown = planner.waypoints
            self._publish_plan(planner)

    def _is_news(self, now: float, status: PlannerStatus, goal_id: bytes) -> bool:
        """Whether to publish a status: once a second if only its reason changes, such as a count of seconds."""
        if self._last is None or (status, goal_id) == self._last:
            return self._last is None
        before, goal_before = self._last
        same = (status.state, status.fault, goal_id) == (before.state, before.fault, goal_before)
        return not same or not 0 <= now - self._published < _REASON_PERIOD

    def show(self, planner: PathPlanner, pose: Pose | None) -> None:
        """Send a picture if the port has receivers."""
        if self._image is None or not self._image.has_readers:
            return
        pixels = draw(planner, pose)
        if pixels is not None:
            self._image.write(ImageRgb.of(pixels))

    def _publish_plan(self, planner: PathPlanner) -> None:
        header = self._header()
        poses = [waypoint.pose for waypoint in planner.waypoints]
        self._publish_path(poses)
        markers: list[Message] = [{"header": header, "action": _DELETE_ALL}]
        if poses:
            points = [{"x": pose.x, "y": pose.y, "z": 0.05} for pose in poses]
            still = {"header": header, "pose": pose_message(Pose(0.0, 0.0, 0.0)), "color": _BLUE, "points": points}
            dots = {"x": 0.1, "y": 0.1, "z": 0.1}
            markers += [
                {**still, "ns": "way", "id": 1, "type": _LINES, "scale": {"x": 0.03, "y": 0.0, "z": 0.0}},
                {**still, "ns": "waypoints", "id": 2, "type": _SPHERES, "scale": dots},
                {"header": header, "ns": "goal", "id": 3, "type": _ARROW, "pose": pose_message(poses[-1]),
                 "scale": {"x": 0.5, "y": 0.08, "z": 0.08}, "color": _PINK},
            ]  # fmt: skip
        self._markers.publish({"markers": markers})


_ROBOT, _NOSE, _GOAL, _PATH, _POINT = (0, 120, 0), (255, 255, 255), (200, 0, 120), (0, 60, 220), (0, 160, 255)
_TIGHT = (255, 236, 190)  # free cells in which the robot does not fit

Pixels = NDArray[np.uint8]


def draw(planner: PathPlanner, pose: Pose | None, scale: int = 1) -> Pixels | None:
    """Draw the map from above, (height, width, 3) bytes with `scale` pixels per cell; None without a map.

    With one pixel per cell, a pixel's column and row are those of the cell, so that a click is a goal.
    """
    ground = planner.ground
    if ground is None:
        return None
    flags = ground.grid.flags
    pixels = picture_of_flags(flags)
    pixels[ground.kept] = COLORS[MapFlag.KEEP_OUT]
    pixels[(flags == MapFlag.FREE) & (ground.weights == 0) & ~ground.kept & ~ground.solid] = _TIGHT
    clutter = planner.clutter
    if clutter is not None and len(clutter.cells):
        rows, columns = clutter.cells.T
        pixels[rows, columns] = COLORS[MapFlag.TEMPORARY_OBSTACLE]
    from PIL import Image, ImageDraw  # most planners are never drawn

    image = Image.fromarray(pixels)
    if scale > 1:
        image = image.resize((image.width * scale, image.height * scale), Image.Resampling.NEAREST)
    canvas = ImageDraw.Draw(image)

    def pixel(x: float, y: float) -> tuple[float, float]:
        column, row = ground.grid.in_cells((x, y))
        return float(column) * scale, float(row) * scale

    poses = [waypoint.pose for waypoint in planner.waypoints]
    line = [pixel(point.x, point.y) for point in ([pose, *poses] if pose is not None else poses)]
    if len(line) > 1:
        canvas.line(line, fill=_PATH, width=max(1, scale))
    for waypoint in poses:
        _disc(canvas, pixel(waypoint.x, waypoint.y), max(1.0, scale), _POINT)
    size = ground.radius / ground.grid.resolution * scale
    target = planner.target
    if target is not None and target.map_name == ground.name:
        _arrow(canvas, pixel(target.pose.x, target.pose.y), target.pose.theta, size, _GOAL)
    if pose is not None:
        _arrow(canvas, pixel(pose.x, pose.y), pose.theta, size, _ROBOT)
    return np.asarray(image)


def png(planner: PathPlanner, pose: Pose | None) -> bytes | None:
    """Draw the map as a PNG file, whose longer side has 600 pixels or more; None without a map."""
    if planner.ground is None:
        return None
    rows, columns = planner.ground.weights.shape
    pixels = draw(planner, pose, max(1, math.ceil(600 / max(rows, columns))))
    if pixels is None:
        return None
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG")
    return file.getvalue()


def _disc(canvas: Any, place: tuple[float, float], radius: float, color: tuple[int, int, int]) -> None:
    x, y = place
    canvas.ellipse((x - radius, y - radius, x + radius, y + radius), fill=color)


def _arrow(canvas: Any, place: tuple[float, float], theta: float, size: float, color: tuple[int, int, int]) -> None:
    """Draw a disc with a line toward its heading."""
    _disc(canvas, place, size, color)
    if math.isfinite(theta):
        end = place[0] + size * math.cos(theta), place[1] - size * math.sin(theta)
        canvas.line((place, end), fill=_NOSE, width=1)


def goal_of_click(ground: Ground | None, values: Sequence[Any]) -> Pose:
    """Return the goal of a click or drag on the map's picture; raises `ValueError` if invalid, or without a map.

    A click is ``x y``, a drag ``x0 y0 x1 y1``: the goal is the first pixel, its heading points to the second. Pixel
    0, 0 is the upper left one.
    """
    if ground is None:
        raise ValueError("no map to click on")
    numbers = [float(value) for value in values if isinstance(value, (int, float)) and not isinstance(value, bool)]
    if len(numbers) != len(values) or len(numbers) not in (2, 4) or not all(map(math.isfinite, numbers)):
        raise ValueError(f"a click is x y, a drag x0 y0 x1 y1: {list(values)!r:.100} is neither")
    x, y = map(float, ground.grid.centers_of(numbers[:2]))
    if len(numbers) == 2 or numbers[:2] == numbers[2:]:
        return Pose(x, y, math.nan)
    to_x, to_y = map(float, ground.grid.centers_of(numbers[2:]))
    return Pose(x, y, math.atan2(to_y - y, to_x - x))


HELP = (
    "help: list the commands",
    "get_robot_radius: distance to walls in meters",
    "set_robot_radius R: keep R meters from walls, and plan a new path",
)
_MOST = 3.0


class PathPlannerDevice(PlannerDevice):
    """Serves INavigation2D; ``brake`` stops the robot at once, on any thread, before a stop or a pause."""

    def __init__(self, module: PlannerModule, calls: Calls, planner: PathPlanner, brake: Callable[[], None]) -> None:
        super().__init__(module, calls)
        self._planner, self._brake = planner, brake

    def followPath(self, path: Map2DPath) -> None:
        self._move(lambda: self._module.drive_locally(*map(place_of, path)))

    @override
    def stopNavigation(self) -> None:
        self._brake()
        super().stopNavigation()

    @override
    def suspendNavigation(self, seconds: float) -> None:
        self._brake()
        super().suspendNavigation(seconds)

    def recomputeCurrentNavigationPath(self) -> None:
        def recompute() -> None:
            if not self._planner.active:
                raise PlanError(Fault.OTHER, "no active goal")
            self._planner.recompute()

        self._do(recompute)

    def getCurrentNavigationWaypoint(self) -> Map2DLocation | None:
        def current() -> Map2DLocation | None:
            ground, point = self._planner.ground, self._planner.waypoint
            return None if point is None or ground is None else location_of(ground.name, point.pose)

        return self._do(current)

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath | None:  # noqa: ARG002
        """Return the path for either kind, like YARP's own planner."""

        def path() -> Map2DPath | None:
            ground, points = self._planner.ground, self._planner.waypoints
            return None if ground is None else Map2DPath([location_of(ground.name, point.pose) for point in points])

        return self._do(path)

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        if kind is NavigationMapTypeEnum.local_map:
            return self._do(self._module.local_map)
        ground = self._planner.ground
        return None if ground is None else ground.grid


class PlannerServer(Navigation2DServer):
    """Serves INavigation2D, and commands that get and set the robot's radius in meters."""

    def __init__(self, device: object, get_radius: Callable[[], float], set_radius: Callable[[float], Any]) -> None:
        super().__init__(device)
        self._get, self._set = get_radius, set_radius

    @override
    def command(self, words: list[Any]) -> list[Any] | None:
        """Answer a Bottle; return None for an unknown command; raises `ValueError` for an invalid radius."""
        verb, *arguments = words or [""]
        if verb in ("help", "[help]") and not arguments:
            return ["[many]", *HELP]
        if verb == "get_robot_radius":
            return [self._get()]
        if verb != "set_robot_radius":
            return None
        value = arguments[0] if len(arguments) == 1 else None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value <= _MOST:
            given = " ".join(map(str, arguments)) or "nothing"
            raise ValueError(f"the robot's radius must be one number above 0 and at most {_MOST:g} m, not {given}")
        self._set(float(value))
        return ["[ok]"]
