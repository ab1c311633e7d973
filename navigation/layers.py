"""Layers of a map (``nav_msgs/msg/OccupancyGrid``): what a robot would touch that a laser does not see."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.config.sections.planners import ObstacleSection
from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from navigation.frames import FramesError, RobotFrames
from navigation.maps.grid import from_grid
from navigation.messages import GRID, Message
from navigation.pose import Pose
from yarp_compat.dev.mapflag import MapFlag

_FINE, _PARTS = 0.05, 20  # metres, and how many of them a cell's side has at most

Places = NDArray[np.float64]


class LayerError(ValueError):
    """A layer that cannot be used; the text says why."""


def read_layer(message: Mapping[str, Any]) -> Places:
    """(n, 2) the middles of a layer's cells from 50 on, metres in its own frame; raises `LayerError`.

    Of cells wider than 5 cm they are those of its parts: who keeps away from a middle keeps away from all of it.
    """
    try:
        grid = from_grid(message, "layer")
    except ValueError as err:
        raise LayerError(str(err)) from None
    if not (grid.resolution > 0.0 and np.isfinite((grid.resolution, *grid.origin.to_ros())).all()):
        raise LayerError(f"info: cells of {grid.resolution} m from {grid.origin.to_ros()} are nowhere")
    rows, columns = np.nonzero(grid.flags == MapFlag.WALL)
    middles = grid.centers_of(np.stack((columns, rows), axis=1))
    parts = min(math.ceil(grid.resolution / _FINE - 1e-6), _PARTS)
    steps = ((np.arange(parts) + 0.5) / parts - 0.5) * grid.resolution
    beside = on(np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2), Pose(0.0, 0.0, grid.origin.to_ros()[2]))
    return (middles[:, None] + beside).reshape(-1, 2)


class LayersHeard:
    """Hears the layers among some sources, and gives each one's places on the map to ``take``, with its topic.

    Args:
        now: the time in seconds.

    Attributes:
        trouble: by topic, why what it said last cannot be used.
    """

    def __init__(
        self,
        host: Host,
        sources: Iterable[ObstacleSection],
        frames: RobotFrames,
        take: Callable[[str, Places], object],
        now: Callable[[], float],
        trouble: dict[str, str] | None = None,
    ) -> None:
        self._frames, self._take, self._now = frames, take, now
        self._graph = host.node.hub.graph
        self._heard: dict[str, float] = {}
        self._going_on: dict[str, ObstacleSection] = {}
        self.trouble = {} if trouble is None else trouble
        for source in sources:
            if source.type == "layer":
                host.node.subscription(source.topic, GRID, partial(self._hear, source), LATCHED)
        host.on_jump(lambda: self._heard.update(dict.fromkeys(self._heard, now())))

    def silent(self) -> str:
        """Which layer says nothing any more, and since when; "" where none does.

        One that never said two things within its ``timeout`` is latched: it speaks when it changes, or once, and is
        silent once nobody publishes it any more.
        """
        for topic, heard in self._heard.items():
            source, silent = self._going_on.get(topic), ""
            if source is not None:
                silent = source.silent(heard, self._now())
            elif not self._graph.publishers(topic):
                silent = f"the layer {topic} is silent: nobody publishes it any more"
            if silent:
                why = self.trouble.get(topic)
                return silent + (f" ({why})" if why else "")
        return ""

    def _hear(self, source: ObstacleSection, message: Message) -> None:
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
        if topic in self._heard and not source.silent(self._heard[topic], now):
            self._going_on[topic] = source
        self._heard[topic] = now
        self._take(topic, places)


def on(places: Places, at: Pose) -> Places:
    """Places (n, 2) of a frame that is at a pose in another one, in that one."""
    c, s = np.cos(at.theta), np.sin(at.theta)
    found: Places = places @ np.array([(c, s), (-s, c)]) + (at.x, at.y)
    return found
