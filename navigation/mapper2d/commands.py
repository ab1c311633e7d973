"""The commands of ``/mapper2D/rpc``, and painting on a picture of the map."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from typing_extensions import override

from bridge.stores.kinds import MAP
from bridge.stores.store import Store
from navigation.map2d_server.files import MapsFolder
from navigation.mapper2d.graph_file import SUFFIX
from navigation.mapper2d.mapper import MOST_BRUSH, PAINTS, Mapper
from navigation.mapper2d.source import PoseSource
from navigation.mapping_commands import MappingCommands
from navigation.pose import Pose
from yarp_compat.dev.mapflag import MapFlag, picture_of_flags
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.mapinfo import MapGrid2DInfo
from yarp_compat.sig.image import ImageRgb

_ROBOT = (0, 90, 200)
_LENGTH = 0.4  # meters of the line that shows the robot's heading
_LONGEST_NAME = 200
"""Longer quoted names of maps are cut in file names, which file systems limit to 255 bytes."""


class Canvas:
    """Draws the map with one pixel per cell, and paints on clicks."""

    def __init__(self, mapper: Mapper) -> None:
        self._mapper = mapper
        self._flag, self._brush = MapFlag.KEEP_OUT, 1
        self._shown: MapGrid2DInfo | None = None

    def use(self, paint: str) -> None:
        """Select what clicks paint; raises `ValueError` for an unknown name."""
        if paint not in PAINTS:
            raise ValueError(f"unknown pixel type {paint[:20]!r}; use {', '.join(PAINTS)}")
        self._flag = PAINTS[paint]

    def size(self, cells: float) -> None:
        """Set the brush's width in cells; raises `ValueError` for an invalid width."""
        if cells != int(cells) or not 1 <= cells <= MOST_BRUSH:
            raise ValueError(f"a brush must have 1 to {MOST_BRUSH} cells, not {cells:g}")
        self._brush = int(cells)

    def paint(self, at: tuple[float, float], to: tuple[float, float]) -> int:
        """Paint a line between two points (meters); return the number of cells. Raises `ValueError` off the map."""
        return self._mapper.paint(at, self._flag, self._brush, to)

    def picture(self, robot: Pose | None) -> ImageRgb:
        """Draw the current map, with the robot if its pose is known."""
        grid = self._mapper.grid()
        pixels = picture_of_flags(grid.flags)
        if robot is not None:
            along = np.linspace(0.0, _LENGTH, 2 * math.ceil(_LENGTH / grid.resolution) + 1)
            line = np.stack((robot.x + along * math.cos(robot.theta), robot.y + along * math.sin(robot.theta)), -1)
            columns, rows = grid.cells_at(line).T
            on_map = (columns >= 0) & (columns < grid.width()) & (rows >= 0) & (rows < grid.height())
            pixels[rows[on_map], columns[on_map]] = _ROBOT
        self._shown = MapGrid2DInfo(grid.name, grid.width(), grid.height(), grid.resolution, grid.origin)
        return ImageRgb.of(pixels)

    def click(self, values: Sequence[Any]) -> int:
        """Paint at a click on the last picture; return the number of painted cells.

        The values are ``x y``, or ``x0 y0 x1 y1`` of a drag: pixels from the upper left one. Raises `ValueError` for
        other values, or for pixels outside the picture.
        """
        numbers = all(isinstance(value, (int, float)) and math.isfinite(value) for value in values)
        if len(values) not in (2, 4) or not numbers:
            raise ValueError(f"a click must be (x y), a drag (x0 y0 x1 y1), not {list(values)[:5]}")
        shown = self._shown
        if shown is None:
            raise ValueError("clicks need a picture of the map, which has not been sent yet")
        pixels = np.floor(np.reshape([float(value) for value in values], (-1, 2)))
        if not ((pixels >= 0).all() and (pixels < (shown.m_width, shown.m_height)).all()):
            raise ValueError(f"{list(values)} is outside the map's picture of {shown.m_width} x {shown.m_height}")
        places = [(float(x), float(y)) for x, y in shown.centers_of(pixels)]
        return self.paint(places[0], places[-1])


HELP = (
    "help: list the commands",
    "start: start mapping",
    "stop: stop mapping",
    "clear: start a new map",
    "initLoc MAP X Y THETA: set the map's name and the robot's current pose (meters, degrees)",
    "save_to_file FILE: save the map in the maps folder, as .map for YARP or .yaml for ROS",
    "save_to_mapserver: save the map in the store, for map servers and planners",
    "load_from_file FILE: load a map from the maps folder and continue it",
    "load_from_mapserver MAP: load a map from the store and continue it",
    "set_pixel_type wall|free|unknown|keepout: what clicks on map:o paint; unknown resets cells",
    "set_pixel_size N: the brush's width in cells",
    "paint X Y [X Y]: paint a point, or a line, in meters",
    "enlarge METERS: add unknown cells on each side",
    "enlarge_obstacles METERS: enlarge walls on published maps; 0 for none",
)


class MapperCommands(MappingCommands):
    """Answers commands of the RPC port. Used only on the module's thread."""

    def __init__(
        self, mapper: Mapper, canvas: Canvas, source: PoseSource, store: Callable[[], Store], folder: MapsFolder
    ) -> None:
        self._mapper, self._canvas, self._source = mapper, canvas, source
        self._store, self._folder = store, folder
        super().__init__(HELP, {
            "start": self._start,
            "stop": self._stop,
            "clear": self._clear,
            "initLoc": self._locate,
            "save_to_file": self._save_file,
            "save_to_mapserver": lambda _arguments: self.save(),
            "load_from_file": self._load_file,
            "load_from_mapserver": self._load,
            "set_pixel_type": self._type,
            "set_pixel_size": self._size,
            "paint": self._paint,
            "enlarge": self._enlarge,
            "enlarge_obstacles": self._enlarge_obstacles,
        })  # fmt: skip

    @override
    def save(self) -> str:
        """Save the map in the store; return a text for people. Raises `StoreError`, and `OSError` for the graph."""
        grid = self._source.grid()
        with self._source.saving(self._graph_in_store(grid.name)):
            self._store().put(MAP, grid.name, grid)
        return f"Map {grid.name} saved into the store."

    def save_file(self, name: str, *suffixes: str) -> str:
        """Save the map and its graph in the maps folder; a name without a suffix gets the first one.

        Returns a text for people. Raises `ValueError` for a name that is not plain, and `OSError`.
        """
        file = self._folder.new(name, *suffixes)
        grid = self._source.grid()
        with self._source.saving(self._folder.file(file.stem + SUFFIX, SUFFIX)):
            grid.save(file)
        return f"Map {self._mapper.name} saved as {file.name}."

    def _start(self, _arguments: list[Any]) -> str:
        self._mapper.mapping = True
        return "Mapping."

    def _stop(self, _arguments: list[Any]) -> str:
        self._mapper.mapping = False
        return "Stopped; 'start' continues."

    def _clear(self, _arguments: list[Any]) -> str:
        self._source.clear()
        return "Started a new map."

    def _locate(self, arguments: list[Any]) -> str:
        if len(arguments) != 4 or not isinstance(arguments[0], str):
            raise ValueError("usage: initLoc MAP X Y THETA (meters, degrees)")
        x, y, theta = _numbers(arguments[1:])
        self._mapper.name = _name(arguments[0])
        self._source.locate(Pose(x, y, math.radians(theta)))
        return f"The robot is at {x:g}, {y:g} m, {theta:g} degrees on {self._mapper.name}."

    def _save_file(self, arguments: list[Any]) -> str:
        return self.save_file(_word(arguments, "FILE"), ".map", ".yaml", ".yml")

    def _load_file(self, arguments: list[Any]) -> str:
        file = self._folder.existing(_word(arguments, "FILE"), ".map", ".yaml", ".yml")
        graph = self._folder.file(file.stem + SUFFIX, SUFFIX)
        self._source.load(MapGrid2D.load(file, jail=self._folder.path), graph)
        return f"Map {self._mapper.name} loaded; mapping continues on it."

    def _load(self, arguments: list[Any]) -> str:
        name = _word(arguments, "MAP")
        grid = self._store().get(MAP, name)
        if grid is None:
            raise ValueError(f"no map {name!r} in the store")
        self._source.load(grid, self._graph_in_store(grid.name))
        return f"Map {self._mapper.name} loaded; mapping continues on it."

    def _graph_in_store(self, name: str) -> Path:
        """Return the file with the graph of a map of the store."""
        quoted = quote(name, safe="")
        if len(quoted) > _LONGEST_NAME:
            quoted = f"{quoted[:_LONGEST_NAME]}-{hashlib.sha256(name.encode()).hexdigest()[:16]}"
        return self._folder.path / "graphs" / (quoted + SUFFIX)

    def _type(self, arguments: list[Any]) -> str:
        self._canvas.use(_word(arguments, "wall|free|unknown|keepout"))
        return f"Clicks paint {arguments[0]}."

    def _size(self, arguments: list[Any]) -> str:
        (size,) = _numbers(arguments, 1)
        self._canvas.size(size)
        return f"The brush has {size:g} by {size:g} cells."

    def _paint(self, arguments: list[Any]) -> str:
        places = _numbers(arguments, 2, 4)
        cells = self._canvas.paint((places[0], places[1]), (places[-2], places[-1]))
        return f"{cells} cells painted."

    def _enlarge(self, arguments: list[Any]) -> str:
        (meters,) = _numbers(arguments, 1)
        self._mapper.enlarge(meters)
        return "The map is {:g} by {:g} m.".format(*self._mapper.size)

    def _enlarge_obstacles(self, arguments: list[Any]) -> str:
        (meters,) = _numbers(arguments, 1)
        if not 0.0 <= meters <= 5.0:
            raise ValueError(f"obstacles can be enlarged by 0 to 5 m, not {meters:g}")
        self._mapper.enlarged = meters
        return f"Published maps have obstacles enlarged by {meters:g} m."


def _numbers(arguments: list[Any], *counts: int) -> list[float]:
    if (counts and len(arguments) not in counts) or any(
        isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value)
        for value in arguments
    ):
        wanted = " or ".join(map(str, counts)) or "three"
        raise ValueError(f"the command needs {wanted} finite numbers, not {' '.join(map(str, arguments)) or 'none'}")
    return [float(value) for value in arguments]


def _word(arguments: list[Any], name: str) -> str:
    if len(arguments) != 1 or not isinstance(arguments[0], str):
        raise ValueError(f"the command needs one argument {name}, not {' '.join(map(str, arguments)) or 'none'}")
    return arguments[0]


def _name(name: str) -> str:
    if not 1 <= len(name) <= 64 or not name.isprintable():
        raise ValueError(f"invalid map name {name[:60]!r}: it must have 1 to 64 printable characters")
    return name
