"""The map, the way on it, the robot and its goal, drawn."""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from navigation.pose import Pose
from navigation.robot_path_planner.planner import PathPlanner
from yarp_compat.dev.mapcolours import COLOURS, picture_of_flags
from yarp_compat.dev.mapflag import MapFlag

_ROBOT, _NOSE, _GOAL, _WAY, _POINT = (0, 120, 0), (255, 255, 255), (200, 0, 120), (0, 60, 220), (0, 160, 255)
_TIGHT = (255, 236, 190)
"""Free cells in which the robot does not fit."""

Pixels = NDArray[np.uint8]


def draw(planner: PathPlanner, pose: Pose | None, scale: int = 1) -> Pixels | None:
    """The map from above, (height, width, 3) bytes, so many pixels a cell; None where there is no map.

    With one pixel a cell, a pixel's column and row are the cell's: so clicks on it are goals.
    """
    ground = planner.ground
    if ground is None:
        return None
    flags = ground.grid.flags
    pixels = picture_of_flags(flags)
    pixels[ground.kept] = COLOURS[MapFlag.KEEP_OUT]
    pixels[(flags == MapFlag.FREE) & (ground.weights == 0) & ~ground.kept & ~ground.solid] = _TIGHT
    clutter = planner.clutter
    if clutter is not None and len(clutter.cells):
        rows, columns = clutter.cells.T
        pixels[rows, columns] = COLOURS[MapFlag.TEMPORARY_OBSTACLE]
    image = Image.fromarray(pixels)
    if scale > 1:
        image = image.resize((image.width * scale, image.height * scale), Image.Resampling.NEAREST)
    canvas = ImageDraw.Draw(image)

    def at(x: float, y: float) -> tuple[float, float]:
        column, row = ground.grid.in_cells((x, y))
        return float(column) * scale, float(row) * scale

    way = [each.pose for each in planner.waypoints]
    line = [at(each.x, each.y) for each in ([pose, *way] if pose is not None else way)]
    if len(line) > 1:
        canvas.line(line, fill=_WAY, width=max(1, scale))
    for each in way:
        _disc(canvas, at(each.x, each.y), max(1.0, scale), _POINT)
    size = ground.radius / ground.grid.resolution * scale
    target = planner.target
    if target is not None and target.map_name == ground.name:
        _arrow(canvas, at(target.pose.x, target.pose.y), target.pose.theta, size, _GOAL)
    if pose is not None:
        _arrow(canvas, at(pose.x, pose.y), pose.theta, size, _ROBOT)
    return np.asarray(image)


def png(planner: PathPlanner, pose: Pose | None) -> bytes | None:
    """The same as a PNG file of 600 pixels or more; None where there is no map."""
    if planner.ground is None:
        return None
    rows, columns = planner.ground.weights.shape
    pixels = draw(planner, pose, max(1, math.ceil(600 / max(rows, columns))))
    if pixels is None:
        return None
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG")
    return file.getvalue()


def _disc(canvas: Any, place: tuple[float, float], radius: float, colour: tuple[int, int, int]) -> None:
    x, y = place
    canvas.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)


def _arrow(canvas: Any, place: tuple[float, float], theta: float, size: float, colour: tuple[int, int, int]) -> None:
    """A disc with a line where it heads."""
    _disc(canvas, place, size, colour)
    if math.isfinite(theta):
        end = place[0] + size * math.cos(theta), place[1] - size * math.sin(theta)
        canvas.line((place, end), fill=_NOSE, width=1)
