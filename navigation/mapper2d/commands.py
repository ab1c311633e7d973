"""The commands of ``/mapper2D/rpc``, and the map as a picture to paint on."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from bridge.stores.entry import StoreError
from bridge.stores.kinds import MAP
from bridge.stores.store import Store
from navigation.map2d_server.files import MapsFolder
from navigation.mapper2d.mapper import MOST_BRUSH, PAINTS, Mapper
from navigation.mapper2d.poses import Poses
from navigation.pose import Pose
from navigation.yarp import Commands
from yarp_compat.dev.mapflag import MapFlag, picture_of_flags
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.mapinfo import MapGrid2DInfo
from yarp_compat.sig.image import ImageRgb

_ROBOT = (0, 90, 200)
_LENGTH = 0.4  # metres of the line that shows where the robot looks


class Canvas:
    """Shows the map, a pixel for each cell, and paints where it is clicked."""

    def __init__(self, mapper: Mapper) -> None:
        self._mapper = mapper
        self._flag, self._brush = MapFlag.KEEP_OUT, 1
        self._shown: MapGrid2DInfo | None = None

    def use(self, paint: str) -> None:
        """Paint so; raises `ValueError` where there is no such paint."""
        if paint not in PAINTS:
            raise ValueError(f"{paint[:20]!r} cannot be painted; {', '.join(PAINTS)} can")
        self._flag = PAINTS[paint]

    def size(self, cells: float) -> None:
        """Have a brush of so many cells along a side; raises `ValueError`."""
        if cells != int(cells) or not 1 <= cells <= MOST_BRUSH:
            raise ValueError(f"a brush has 1 to {MOST_BRUSH} cells, not {cells:g}")
        self._brush = int(cells)

    def paint(self, at: tuple[float, float], to: tuple[float, float]) -> int:
        """Paint from a place to another (metres); how many cells. Raises `ValueError` where one is off the map."""
        return self._mapper.paint(at, self._flag, self._brush, to)

    def picture(self, robot: Pose | None) -> ImageRgb:
        """The map now, with the robot on it where that is known."""
        grid = self._mapper.grid()
        pixels = picture_of_flags(grid.flags)
        if robot is not None:
            along = np.linspace(0.0, _LENGTH, 2 * math.ceil(_LENGTH / grid.resolution) + 1)
            line = np.stack((robot.x + along * math.cos(robot.theta), robot.y + along * math.sin(robot.theta)), -1)
            columns, rows = grid.cells_at(line).T
            there = (columns >= 0) & (columns < grid.width()) & (rows >= 0) & (rows < grid.height())
            pixels[rows[there], columns[there]] = _ROBOT
        self._shown = MapGrid2DInfo(grid.name, grid.width(), grid.height(), grid.resolution, grid.origin)
        return ImageRgb.of(pixels)

    def clicked(self, values: Sequence[Any]) -> int:
        """Paint where the picture that was shown last was clicked; how many cells.

        The values are ``x y``, or ``x0 y0 x1 y1`` of a drag: pixels from the upper left one. Raises `ValueError` if it
        is no click, or not on the picture.
        """
        numbers = all(isinstance(value, (int, float)) and math.isfinite(value) for value in values)
        if len(values) not in (2, 4) or not numbers:
            raise ValueError(f"a click is (x y), a drag (x0 y0 x1 y1); not {list(values)[:5]}")
        shown = self._shown
        if shown is None:
            raise ValueError("nothing was clicked: no picture of the map was shown yet")
        pixels = np.floor(np.reshape([float(value) for value in values], (-1, 2)))
        if not ((pixels >= 0).all() and (pixels < (shown.m_width, shown.m_height)).all()):
            raise ValueError(f"{list(values)} is not on the map's picture of {shown.m_width} x {shown.m_height}")
        places = [(float(x), float(y)) for x, y in shown.centers_of(pixels)]
        return self.paint(places[0], places[-1])


HELP = (
    "help: these lines",
    "start: take scans",
    "stop: take none",
    "clear: begin a new map",
    "initLoc MAP X Y THETA: the robot is there now, on the map of that name (metres, degrees)",
    "save_to_file FILE: a name in the maps folder, .map for YARP or .yaml for ROS",
    "save_to_mapserver: into the store, for map servers and planners",
    "load_from_file FILE: go on with a map of the maps folder",
    "load_from_mapserver MAP: go on with a map of the store",
    "set_pixel_type wall|free|unknown|keepout: what clicks on map:o paint; unknown forgets",
    "set_pixel_size N: cells along a side of the brush",
    "paint X Y [X Y]: as a click, or a drag, at places in metres",
    "enlarge METRES: add so much of the unknown at each side",
    "enlarge_obstacles METRES: mark so much around walls on maps that are given out; 0 for none",
)


class MapperCommands(Commands):
    """Answers commands of the RPC port. Called on the module's thread."""

    def __init__(
        self, mapper: Mapper, canvas: Canvas, poses: Poses, store: Callable[[], Store], folder: MapsFolder
    ) -> None:
        self._mapper, self._canvas, self._poses = mapper, canvas, poses
        self._store, self._folder = store, folder
        super().__init__(HELP, {
            "start": self._start,
            "stop": self._stop,
            "clear": self._clear,
            "initLoc": self._locate,
            "save_to_file": self._save_file,
            "save_to_mapserver": lambda _rest: self.save(),
            "load_from_file": self._load_file,
            "load_from_mapserver": self._load,
            "set_pixel_type": self._type,
            "set_pixel_size": self._size,
            "paint": self._paint,
            "enlarge": self._enlarge,
            "enlarge_obstacles": self._enlarge_obstacles,
        })  # fmt: skip

    def answer(self, values: list[Any]) -> list[Any]:
        """As `Commands.answer`."""
        try:
            return super().answer(values)
        except (OSError, StoreError) as err:
            raise ValueError(f"{values[0]}: {err}") from None

    def save(self) -> str:
        """Put the map into the store; what was done. Raises `StoreError`."""
        grid = self._mapper.grid()
        self._store().put(MAP, grid.name, grid)
        return f"Map {grid.name} saved into the store."

    def _start(self, _rest: list[Any]) -> str:
        self._mapper.mapping = True
        return "Mapping."

    def _stop(self, _rest: list[Any]) -> str:
        self._mapper.mapping = False
        return "Not mapping; 'start' goes on."

    def _clear(self, _rest: list[Any]) -> str:
        self._mapper.clear()
        return "A new map is begun."

    def _locate(self, rest: list[Any]) -> str:
        if len(rest) != 4 or not isinstance(rest[0], str):
            raise ValueError("initLoc MAP X Y THETA (metres, degrees)")
        x, y, theta = _numbers(rest[1:])
        self._mapper.name = _name(rest[0])
        self._poses.set(Pose(x, y, math.radians(theta)))
        return f"The robot is at {x:g}, {y:g} m, {theta:g} degrees on {self._mapper.name}."

    def _save_file(self, rest: list[Any]) -> str:
        file = self._folder.new(_word(rest, "FILE"), ".map", ".yaml", ".yml")
        self._mapper.grid().save(file)
        return f"Map {self._mapper.name} saved as {file.name}."

    def _load_file(self, rest: list[Any]) -> str:
        file = self._folder.existing(_word(rest, "FILE"), ".map", ".yaml", ".yml")
        self._mapper.load(MapGrid2D.load(file, jail=self._folder.path))
        return f"Map {self._mapper.name} loaded; mapping goes on on it."

    def _load(self, rest: list[Any]) -> str:
        name = _word(rest, "MAP")
        found = self._store().get(MAP, name)
        if found is None:
            raise ValueError(f"there is no map {name!r} in the store")
        self._mapper.load(found)
        return f"Map {self._mapper.name} loaded; mapping goes on on it."

    def _type(self, rest: list[Any]) -> str:
        self._canvas.use(_word(rest, "wall|free|unknown|keepout"))
        return f"Clicks paint {rest[0]}."

    def _size(self, rest: list[Any]) -> str:
        (size,) = _numbers(rest, 1)
        self._canvas.size(size)
        return f"The brush has {size:g} by {size:g} cells."

    def _paint(self, rest: list[Any]) -> str:
        places = _numbers(rest, 2, 4)
        cells = self._canvas.paint((places[0], places[1]), (places[-2], places[-1]))
        return f"{cells} cells painted."

    def _enlarge(self, rest: list[Any]) -> str:
        (metres,) = _numbers(rest, 1)
        self._mapper.enlarge(metres)
        return "The map is {:g} by {:g} m.".format(*self._mapper.size)

    def _enlarge_obstacles(self, rest: list[Any]) -> str:
        (metres,) = _numbers(rest, 1)
        if not 0.0 <= metres <= 5.0:
            raise ValueError(f"obstacles are enlarged by 0 to 5 m, not {metres:g}")
        self._mapper.enlarged = metres
        return f"Obstacles are enlarged by {metres:g} m on maps that are given out."


def _numbers(rest: list[Any], *counts: int) -> list[float]:
    if (counts and len(rest) not in counts) or any(
        isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value) for value in rest
    ):
        wanted = " or ".join(map(str, counts)) or "three"
        raise ValueError(f"{wanted} finite numbers are needed, not {' '.join(map(str, rest)) or 'nothing'}")
    return [float(value) for value in rest]


def _word(rest: list[Any], what: str) -> str:
    if len(rest) != 1 or not isinstance(rest[0], str):
        raise ValueError(f"one word is needed: {what}; not {' '.join(map(str, rest)) or 'nothing'}")
    return rest[0]


def _name(name: str) -> str:
    if not 1 <= len(name) <= 64 or not name.isprintable():
        raise ValueError(f"{name[:60]!r} is no name of a map: 1 to 64 letters")
    return name
