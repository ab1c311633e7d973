"""The robot's shape from the configuration, and the store's places, areas, paths and keep-out zones, as channels.

Two channels of this server, updated while a client watches them: `SCENE` (``foxglove.SceneUpdate``: the robot in its
own frame; places, areas and paths of the current map) and `KEEP_OUT` (``nav_msgs/OccupancyGrid``: 100 in keep-out
zones, 0 elsewhere, as in `navigation.maps.masks`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from foxglove.messages import (
    ArrowPrimitive,
    Color,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneEntityDeletion,
    SceneEntityDeletionType,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector3,
)
from typing_extensions import override

from bridge.config.model import Config
from bridge.foxglove.server import FoxgloveServer
from bridge.messages.definitions.text import full_text
from bridge.messages.values import MessageWriter
from bridge.modules.host import Host
from bridge.web.feeds.feed import Feed
from bridge.web.section import WebSection

if TYPE_CHECKING:
    from bridge.web.feeds.maps import StoreFollower, StoreView

SCENE, KEEP_OUT = "/midspan/scene", "/midspan/keep_out"
GRID = "nav_msgs/msg/OccupancyGrid"
MOST_ENTITIES = 2_000
"""Maximum number of places, areas and paths; further ones are omitted."""

_ROBOT, _PLACE, _AREA, _PATH = (
    Color(r=0.1, g=0.5, b=0.9, a=1.0), Color(r=0.9, g=0.5, b=0.1, a=1.0), Color(r=0.2, g=0.7, b=0.3, a=1.0),
    Color(r=0.6, g=0.4, b=0.8, a=1.0),
)  # fmt: skip
_LINE = 0.03  # width of lines and their height above the floor, meters
_LETTERS = 0.2  # size of texts and their height above the floor, meters


class Scene(Feed):
    """The scene. Runs on the worker's thread, and follows the store like a feed of the console.

    Attributes:
        error: why the content of the store is not shown; "" if it is.
    """

    def __init__(self, host: Host, config: Config, server: FoxgloveServer) -> None:
        super().__init__(SCENE)
        self._host, self._config = host, config
        self._store: StoreFollower | None = None
        self._view: StoreView | None = None
        registry = host.node.registry
        self._grid = registry.schema(GRID)
        self._scene = server.scene(SCENE)
        self._keep_out = server.channel(KEEP_OUT, GRID, full_text(self._grid), {"side": "midspan", "latched": "true"})
        self._watched: frozenset[int] = frozenset()
        self.error = ""

    def watch_channels(self, watched: set[int], late: set[int]) -> None:
        """Follow the store while either channel is watched; new watchers get the current content."""
        channels = frozenset(watched & {self._scene.id(), self._keep_out.id()})
        before, self._watched = self._watched, channels
        if channels and not before:
            self.open()
        elif before and not channels:
            self.close()
        if channels & late:
            self._publish(channels & late)

    @override
    def open(self) -> None:
        from bridge.web.feeds.maps import StoreFollower  # imports image code, which is not needed without a scene

        self._store = self._store or StoreFollower(self._host, self._config)
        self._store.begin(self, self._on_view)

    @override
    def close(self) -> None:
        if self._store is not None:
            self._store.end(self)
        self._view = None

    @override
    def put(self, value: Any, reason: str = "") -> None:
        """Store the reason if the store cannot be read, and clear the shown content."""
        self.error = reason
        if value is None and self._view is not None:
            self._view = None
            self._publish(self._watched)

    def _on_view(self, view: StoreView) -> None:
        self._view, self.error = view, ""
        self._publish(self._watched)

    def _publish(self, channels: frozenset[int]) -> None:
        now = self._host.clock.now_ns()
        if self._scene.id() in channels:
            self._scene.log(self._update(now), log_time=now)
        if self._keep_out.id() in channels and (message := self._mask(now)) is not None:
            self._keep_out.log(message, now)

    def _update(self, now: int) -> SceneUpdate:
        """Return an update that replaces everything with the current content."""
        from bridge.web.feeds.robot import disc  # imports gateway code, which is not needed without a scene

        at = Timestamp(*divmod(now, 1_000_000_000))
        every = SceneEntityDeletion(timestamp=at, type=SceneEntityDeletionType.All)
        section = self._config.section(WebSection)
        corners = section.footprint or disc(section.radius)
        robot = SceneEntity(
            timestamp=at, frame_id=self._config.navigation.base_frame, id="robot", frame_locked=True,
            lines=[_loop(corners, _ROBOT)], arrows=[_arrow(0.0, 0.0, 0.0, section.radius, _ROBOT)],
        )  # fmt: skip
        return SceneUpdate(deletions=[every], entities=[robot, *self._places(at)[:MOST_ENTITIES]])

    def _places(self, at: Timestamp) -> list[SceneEntity]:
        if self._view is None:
            return []
        frame, places = self._config.navigation.frame, self._view.places
        entities: list[SceneEntity] = []

        def add(kind: str, name: str, at_: tuple[float, float], color: Color, **parts: Any) -> None:
            entities.append(
                SceneEntity(
                    timestamp=at, frame_id=frame, id=f"{kind}:{name}", frame_locked=True,
                    texts=[_label(name, *at_, color)], **parts,
                )
            )  # fmt: skip

        for name, place in places["locations"].items():
            if place["map"] == self._view.name:
                arrow = _arrow(place["x"], place["y"], place["theta"], 0.4, _PLACE)
                add("place", name, (place["x"], place["y"]), _PLACE, arrows=[arrow])
        for kind, color in (("areas", _AREA), ("paths", _PATH)):
            for name, place in places[kind].items():
                if place["map"] == self._view.name and place["points"]:
                    lines = [_loop(place["points"], color, closed=kind == "areas")]
                    add(kind[:-1], name, place["points"][0], color, lines=lines)
        return entities

    def _mask(self, now: int) -> bytes | None:
        """Return the keep-out zones, from the flags of the current map, as a message; None without a map."""
        grid = None if self._view is None else self._view.grid
        if grid is None:
            return None
        from navigation.maps.grid import data_of, message_of, turned
        from navigation.maps.masks import keepout_mask

        lies = turned(grid)
        message = message_of(data_of(keepout_mask(lies)), lies, self._config.navigation.frame, now)
        return MessageWriter(self._grid).message(message)

    def end(self) -> None:
        """Stop following the store, and end its thread."""
        self.close()
        if self._store is not None:
            self._store.close()


def _loop(points: Sequence[Sequence[float]], color: Color, *, closed: bool = True) -> LinePrimitive:
    kind = LinePrimitiveLineType.LineLoop if closed else LinePrimitiveLineType.LineStrip
    corners = [Point3(x=float(x), y=float(y), z=_LINE) for x, y in points]
    return LinePrimitive(type=kind, pose=_pose(0.0, 0.0, 0.0), thickness=_LINE, points=corners, color=color)


def _arrow(x: float, y: float, theta: float, length: float, color: Color) -> ArrowPrimitive:
    return ArrowPrimitive(
        pose=_pose(x, y, theta), shaft_length=0.7 * length, shaft_diameter=0.05, head_length=0.3 * length,
        head_diameter=0.12, color=color,
    )  # fmt: skip


def _label(text: str, x: float, y: float, color: Color) -> TextPrimitive:
    return TextPrimitive(pose=_pose(x, y, 0.0, z=_LETTERS), billboard=True, font_size=_LETTERS, color=color, text=text)


def _pose(x: float, y: float, theta: float, z: float = 0.0) -> Pose:
    orientation = Quaternion(z=math.sin(theta / 2), w=math.cos(theta / 2))
    return Pose(position=Vector3(x=float(x), y=float(y), z=z), orientation=orientation)
