"""Layers of a map (``nav_msgs/msg/OccupancyGrid``): obstacles that a laser does not see."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.config.sections.obstacles import ObstacleSection
from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from navigation.frames import FramesError, RobotFrames
from navigation.maps.grid import from_grid
from navigation.messages import GRID, Message
from navigation.pose import Pose
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

_FINE, _PARTS = 0.05, 20  # meters between the points of a large cell, and the largest number of them per side

Places = NDArray[np.float64]


class LayerError(ValueError):
    """A layer is invalid; the text gives the reason."""


def read_layer(message: Mapping[str, Any]) -> Places:
    """Return points on a layer's cells of 50 or more, (n, 2) meters in the layer's frame; raises `LayerError`."""
    try:
        grid = from_grid(message, "layer")
    except ValueError as err:
        raise LayerError(str(err)) from None
    if not (grid.resolution > 0.0 and np.isfinite((grid.resolution, *grid.origin.to_ros())).all()):
        raise LayerError(f"info: invalid resolution {grid.resolution} m or origin {grid.origin.to_ros()}")
    return spread(grid, np.argwhere(grid.flags == MapFlag.WALL)[:, ::-1])


def spread(grid: MapGrid2D, cells: NDArray[np.int64], *, edges: bool = False) -> Places:
    """Return the centers, in meters, of a map's ``cells``, (n, 2) columns and rows; with ``edges``, their corners.

    A cell wider than 5 cm is split into parts that have their own centers or corners, so that the distance to the
    nearest point is nearly that to the cell.
    """
    middles = grid.centers_of(cells)
    parts = min(math.ceil(grid.resolution / _FINE - 1e-6), _PARTS)
    shares = np.arange(parts + 1) if edges else np.arange(parts) + 0.5
    steps = (shares / parts - 0.5) * grid.resolution
    offsets = on(np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2), Pose(0.0, 0.0, grid.origin.to_ros()[2]))
    return (middles[:, None] + offsets).reshape(-1, 2)


class LayerSubscriptions:
    """Subscribes to the layers among obstacle sources; ``on_layer`` receives a layer's topic and points on the map.

    Args:
        now: returns the time in seconds.

    Attributes:
        trouble: why the last message of a topic is invalid, by topic.
    """

    def __init__(
        self,
        host: Host,
        sources: Iterable[ObstacleSection],
        frames: RobotFrames,
        on_layer: Callable[[str, Places], object],
        now: Callable[[], float],
        trouble: dict[str, str] | None = None,
    ) -> None:
        self._frames, self._on_layer, self._now = frames, on_layer, now
        self._graph = host.node.hub.graph
        self._received: dict[str, float] = {}
        self._periodic: dict[str, ObstacleSection] = {}
        self.trouble = {} if trouble is None else trouble
        for source in sources:
            if source.type == "layer":
                host.node.subscription(source.topic, GRID, partial(self._receive, source), LATCHED)
        host.on_jump(lambda: self._received.update(dict.fromkeys(self._received, now())))

    def silent(self) -> str:
        """Return which layer is silent, and for how long; "" if none is.

        A layer that has never published twice within its ``timeout`` is latched: it publishes on changes only, and is
        silent when it has no publisher.
        """
        for topic, received in self._received.copy().items():  # other threads ask for the health
            source, silent = self._periodic.get(topic), ""
            if source is not None:
                silent = source.silent(received, self._now())
            elif not self._graph.publishers(topic):
                silent = f"the layer {topic} is silent: it has no publisher"
            if silent:
                reason = self.trouble.get(topic)
                return silent + (f" ({reason})" if reason else "")
        return ""

    def _receive(self, source: ObstacleSection, message: Message) -> None:
        topic = source.topic
        frame = message["header"]["frame_id"].lstrip("/")
        try:
            places = read_layer(message)
            if frame != self._frames.map_frame:
                places = on(places, self._frames.on_map(frame))
        except (FramesError, LayerError) as err:
            self.trouble[topic] = str(err)
            return
        self.trouble.pop(topic, None)
        now = self._now()
        if topic in self._received and not source.silent(self._received[topic], now):
            self._periodic[topic] = source
        self._received[topic] = now
        self._on_layer(topic, places)


def on(places: Places, at: Pose) -> Places:
    """Transform points (n, 2) from a frame into another frame, in which the first frame has the pose `at`."""
    c, s = np.cos(at.theta), np.sin(at.theta)
    moved: Places = places @ np.array([(c, s), (-s, c)]) + (at.x, at.y)
    return moved
