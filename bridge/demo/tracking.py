"""Tracks the pose and path of the demo's robot on the hub, and draws them on its map."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

from rich.text import Text

from bridge.client.feed import LatestMessage
from bridge.client.navigation import STATUS, STATUS_TOPIC, place_of, state_text
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.config.sections.navigation import OURS
from bridge.demo.progress import DemoError, DemoProgress
from bridge.display import drawing
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.places import Places

Place = tuple[float, float]

_STEP = 0.1
"""Minimum distance in meters between two stored points of the driven path."""


class RobotTracker:
    """Follows the robot on the hub; ``driven`` are the points of its path so far, in meters."""

    def __init__(self, client: Client) -> None:
        store = client.config.store
        if store.maps is None or store.locations is None:
            raise DemoError("the configuration lacks store.maps and store.locations")
        self.grid = MapGrid2D.load(store.maps)
        self._places = Places.load(store.locations)
        types = Types(client)
        self._status = LatestMessage(client, types, STATUS_TOPIC, STATUS)
        self._localized = LatestMessage(client, types, "/localization/status", "std_msgs/msg/String")
        self._truth = LatestMessage(client, types, "/ground_truth", "nav_msgs/msg/Odometry")
        self._path = LatestMessage(client, types, f"/planner/{OURS[0]}/path", "nav_msgs/msg/Path")
        self.driven: list[Place] = []

    @property
    def localized(self) -> bool:
        """Whether the robot is localized, and there is a gateway for goals."""
        message = self._localized.wait(0.0)
        return (
            message is not None
            and message["data"] == "localized_ok"
            and None not in (self._status.wait(0.0), self._location())
        )

    @property
    def state(self) -> str:
        """The gateway's state as text."""
        message = self._status.wait(0.0)
        return state_text(message) if message is not None else "waiting for the gateway"

    def _location(self) -> Map2DLocation | None:
        message = self._truth.wait(0.0)
        if message is None:
            return None
        _, x, y, degrees = place_of({"header": message["header"], "pose": message["pose"]["pose"]})
        return Map2DLocation(self.grid.name, x, y, degrees)

    def refresh(self, progress: DemoProgress) -> None:
        """Store the robot's location, and report progress."""
        at, localized = self._location(), self._localized.wait(0.0)
        progress.note("the gateway", self.state)
        progress.note("the localizer", localized["data"] if localized is not None else "")
        if at is not None:
            progress.note_pose(at.x, at.y, math.radians(at.theta))
        if at is not None and (not self.driven or math.dist(self.driven[-1], (at.x, at.y)) >= _STEP):
            self.driven.append((at.x, at.y))

    def distance_to(self, room: str) -> float:
        """Return the distance in meters from the robot to a room's place, by ground truth."""
        at, place = self._location(), self._places.locations.get(room)
        return math.inf if at is None or place is None else math.dist((at.x, at.y), (place.x, place.y))

    @property
    def left(self) -> list[Place]:
        """The remaining path, beginning at the robot; empty without a goal."""
        message, at = self._path.wait(0.0), self._location()
        if message is None or at is None or not message["poses"]:
            return []
        line, robot = [(x, y) for _, x, y, _ in map(place_of, message["poses"])], (at.x, at.y)
        parts = list(itertools.pairwise(line))
        passed = min(range(len(parts)), key=lambda part: _distance_to_line(robot, *parts[part]), default=-1)
        return [robot, *line[passed + 1 :]]

    def picture(self, width: int, *, colored: bool) -> list[Text]:
        """Return the map's lines for the terminal: the robot, its path, the rooms."""
        return drawing.lines(self.grid, self._marked(), {}, width, colored=colored, path=self.left)

    def png(self, file: Path) -> None:
        """Write the map with the driven path; raises `OSError`."""
        drawing.draw(self.grid, self._marked(), {}, path=self.driven).save(file, format="PNG")

    def _marked(self) -> dict[str, Map2DLocation]:
        at = self._location()
        return {**self._places.locations, **({} if at is None else {"robot": at})}

    def texts(self) -> dict[str, Any]:
        """Return the robot's location, remaining distance and state, for one line."""
        at, left = self._location(), self.left
        distance = sum(math.dist(a, b) for a, b in itertools.pairwise(left))
        where = "?" if at is None else f"{at.x:5.2f} {at.y:5.2f} m"
        return {"where": where, "left": f"{distance:4.1f} m to go" if left else "", "state": self.state}


def _distance_to_line(place: Place, start: Place, end: Place) -> float:
    """Return the distance in meters of a point from the line segment between two others."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    along = ((place[0] - start[0]) * dx + (place[1] - start[1]) * dy) / max(dx * dx + dy * dy, 1e-12)
    along = min(1.0, max(0.0, along))
    return math.dist(place, (start[0] + along * dx, start[1] + along * dy))
