"""A small flat as an occupancy grid, and rays cast in it; standard library only."""

from __future__ import annotations

import math

RESOLUTION = 0.05
"""Metres of one cell's edge."""

_CELLS = 5
_BLOCK = _CELLS * RESOLUTION
_PLAN = """
####################################
#..............#...................#
#..............#...................#
#......................##..........#
#......................##..........#
#..............#...................#
#..............#...................#
#####..#########.........###########
#..................................#
#..................................#
#.......S..........................#
#..................................#
#..................................#
#####..##########..#####....########
#..............#...........#.......#
#...##.........#...........#.......#
#...##.........#...................#
#..........................#.......#
#..............#...........#.......#
#..............#...........#.......#
####################################
"""
"""One character stands for a block of 5 x 5 cells; ``S`` is where the robot starts, the origin of the frame ``map``."""


class FloorPlan:
    """An occupancy grid of the frame ``map``.

    Attributes:
        origin: x and y of the corner of cell 0, 0, in metres.
        size: width and height in cells.
    """

    def __init__(self) -> None:
        rows = _PLAN.split()[::-1]  # the first line is the farthest in y
        self._walls = [[character == "#" for character in row] for row in rows]
        start = next(i for i, row in enumerate(rows) if "S" in row)
        self.origin = (-(rows[start].index("S") + 0.5) * _BLOCK, -(start + 0.5) * _BLOCK)
        self.size = (len(rows[0]) * _CELLS, len(rows) * _CELLS)

    def occupancy(self) -> bytes:
        """The cells as ``nav_msgs/OccupancyGrid`` has them: 0 free, 100 occupied, row by row."""
        rows = (b"".join((b"\x64" if wall else b"\x00") * _CELLS for wall in row) for row in self._walls)
        return b"".join(row * _CELLS for row in rows)

    def occupied(self, x: float, y: float) -> bool:
        """Whether there is a wall at a position; what lies outside is one."""
        column = math.floor((x - self.origin[0]) / _BLOCK)
        row = math.floor((y - self.origin[1]) / _BLOCK)
        inside = 0 <= row < len(self._walls) and 0 <= column < len(self._walls[0])
        return not inside or self._walls[row][column]

    def cast(self, x: float, y: float, angle: float, reach: float) -> float:
        """Metres from a free position to the next wall along an angle, at most ``reach``.

        Steps from block to block (Amanatides and Woo, A Fast Voxel Traversal Algorithm for Ray Tracing, 1987).
        """
        dx, dy = math.cos(angle), math.sin(angle)
        u, v = (x - self.origin[0]) / _BLOCK, (y - self.origin[1]) / _BLOCK
        column, row = math.floor(u), math.floor(v)
        per_column = _BLOCK / abs(dx) if dx else math.inf
        per_row = _BLOCK / abs(dy) if dy else math.inf
        next_column = per_column * ((column + 1 - u) if dx > 0 else (u - column)) if dx else math.inf
        next_row = per_row * ((row + 1 - v) if dy > 0 else (v - row)) if dy else math.inf
        to_right, to_top = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        while True:
            if next_column < next_row:
                distance, column, next_column = next_column, column + to_right, next_column + per_column
            else:
                distance, row, next_row = next_row, row + to_top, next_row + per_row
            # the plan is walled in all around, so a ray never leaves it
            if distance >= reach or self._walls[row][column]:
                return min(distance, reach)
