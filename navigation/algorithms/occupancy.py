"""Maps from laser scans: each cell's odds of being occupied, kept as logarithms.

A beam makes the cells that it passes more likely free and the one where it ends more likely occupied (Moravec and
Elfes, "High Resolution Maps from Wide Angle Sonar", ICRA 1985; Thrun, Burgard, Fox, "Probabilistic Robotics", table
9.2). Each cell counts once a scan, and a hit outweighs passing beams, so that walls seen at a glancing angle stay.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from bridge.messages.cache import compiled

Odds = NDArray[np.float32]

HIT, PASS = 0.85, -0.4
"""Added to a cell's log odds: probabilities of 0.7 and 0.4."""

LEAST, MOST = -4.0, 4.0
"""Log odds are kept within them, so that what has changed is unlearnt within some ten scans."""

OCCUPIED, FREE = 0.65, 0.196
"""Probabilities beyond which a cell counts as occupied or free, as map_server's thresholds."""


class OccupancyMap:
    """A grid of log odds; 0 is unknown.

    Args:
        rows: cells along y, the first row at the origin's y.
        columns: cells along x.
        resolution: metres a cell.
        origin: (x, y) of the corner of cell (0, 0), metres.

    Attributes:
        odds: (rows, columns).
        marks: (rows, columns) 0, or what the scan at hand has made of a cell.
    """

    def __init__(self, rows: int, columns: int, resolution: float, origin: tuple[float, float]) -> None:
        if rows <= 0 or columns <= 0 or not resolution > 0.0:
            raise ValueError(f"a map has cells, of a size above 0: not {rows} x {columns} of {resolution} m")
        self.resolution, self.origin = resolution, origin
        self.odds: Odds = np.zeros((rows, columns), np.float32)
        self.marks = np.zeros((rows, columns), np.uint8)
        self._touched = np.empty(rows * columns, np.int64)

    def insert(
        self, pose: tuple[float, float, float], ranges: NDArray[np.float64], first: float, step: float, farthest: float
    ) -> int:
        """Take a scan.

        Args:
            pose: of the laser: x, y (metres), direction (radians).
            ranges: metres, one a beam. Infinite: nothing within ``farthest``; NaN: nothing is known.
            first: the first beam's angle from the laser's direction, radians.
            step: the angle from a beam to the next.
            farthest: metres; what is beyond is not looked at.

        Returns:
            the number of cells that it touched.

        Raises:
            ValueError: the pose is not finite.
        """
        if not np.isfinite(pose).all():
            raise ValueError(f"a scan's pose is finite, not {pose}")
        beams = np.ascontiguousarray(ranges, np.float64)
        place = ((pose[0] - self.origin[0]) / self.resolution, (pose[1] - self.origin[1]) / self.resolution)
        reach = farthest / self.resolution
        if not all(-reach <= at <= cells + reach for at, cells in zip(place, self.odds.shape[::-1], strict=True)):
            return 0  # no beam comes to the map
        return int(
            _compiled()(
                self.odds, self.marks, self._touched, *place, pose[2], beams, first, step, farthest, self.resolution
            )
        )

    def probabilities(self) -> NDArray[np.float32]:
        """(rows, columns) each cell's probability of being occupied; 0.5 is unknown."""
        return (1.0 / (1.0 + np.exp(-self.odds))).astype(np.float32)

    def occupancy(self) -> NDArray[np.int8]:
        """(rows, columns) as `nav_msgs/OccupancyGrid` says it: 100 occupied, 0 free, -1 unknown."""
        found = np.full(self.odds.shape, -1, np.int8)
        found[self.odds > np.log(OCCUPIED / (1.0 - OCCUPIED))] = 100
        found[self.odds < np.log(FREE / (1.0 - FREE))] = 0
        return found


def _insert(
    odds: Odds,
    marks: NDArray[np.uint8],
    touched: NDArray[np.int64],
    x: float,
    y: float,
    direction: float,
    ranges: NDArray[np.float64],
    first: float,
    step: float,
    farthest: float,
    resolution: float,
) -> int:
    """Mark what each beam passes (1) and hits (2), then change each marked cell's odds once. Lengths are in cells."""
    rows, columns = odds.shape
    count = 0
    for beam in range(len(ranges)):
        metres = ranges[beam]
        if np.isnan(metres) or metres <= 0.0:
            continue
        hits = metres <= farthest
        length = min(metres, farthest) / resolution
        angle = direction + first + step * beam
        dx, dy = np.cos(angle), np.sin(angle)
        column, row = int(np.floor(x)), int(np.floor(y))
        last_column, last_row = int(np.floor(x + length * dx)), int(np.floor(y + length * dy))
        right, down = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        # how far along the beam the next borders are, and from one border to the next
        next_x = ((column + (right > 0)) - x) / dx if dx != 0.0 else np.inf
        next_y = ((row + (down > 0)) - y) / dy if dy != 0.0 else np.inf
        across, along = (abs(1.0 / dx) if dx != 0.0 else np.inf), (abs(1.0 / dy) if dy != 0.0 else np.inf)
        while True:
            last = column == last_column and row == last_row
            if 0 <= row < rows and 0 <= column < columns:
                mark = 2 if last and hits else 1
                if marks[row, column] == 0:
                    touched[count] = row * columns + column
                    count += 1
                if mark > marks[row, column]:
                    marks[row, column] = mark
            if last or min(next_x, next_y) > length:
                break
            if next_x < next_y:
                column += right
                next_x += across
            else:
                row += down
                next_y += along
    for place in range(count):
        row, column = touched[place] // columns, touched[place] % columns
        change = HIT if marks[row, column] == 2 else PASS
        odds[row, column] = min(max(odds[row, column] + change, LEAST), MOST)
        marks[row, column] = 0
    return count


@cache
def _compiled() -> Any:
    def grid(of: Any) -> Any:
        return numba.types.Array(of, 2, "C")

    number = numba.float64
    line = numba.types.Array(numba.int64, 1, "C")
    beams = numba.types.Array(number, 1, "C")
    signature = numba.int64(
        grid(numba.float32), grid(numba.uint8), line, number, number, number, beams, number, number, number, number
    )
    return compiled(_insert, signature, [Path(__file__)], nogil=True)
