"""Flags that pages paint on a map of the store, with an undo for each change.

A run is ``[row, column, length, flag]`` or ``[row, column, length, flag, was]``: cells of one row of the map's image,
with the first row at the top; flags have YARP's numbers. Without a flag (null), cells get their flags from the
occupancy. With ``was``, only cells that have this flag now are changed, so that an undo preserves what others have
painted since.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from bridge.client.store import StoreClient
from bridge.stores.kinds import MAP
from bridge.stores.store import Write
from bridge.web.verbs.verbs import PageVerb, VerbError, name_of
from yarp_compat.dev.mapflag import MAX_CELLS, MapFlag, flags_of
from yarp_compat.dev.mapgrid import MapGrid2D

MOST_RUNS, MOST_CELLS, MOST_PIECES = 2000, 200_000, 20_000
"""Maximum number of runs in a call, of their cells, and of runs in the undo."""


class Run(NamedTuple):
    """Cells of one row, and their new flag."""

    row: int
    column: int
    length: int
    flag: int | None  #: None: use the flag for the occupancy
    was: int | None  #: the flag that the cells must have now; None: any


def _integer(value: Any, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise ValueError(f"{value!r:.40} is not an integer up to {most}")
    return value


def _run(value: Any) -> Run:
    if not isinstance(value, list) or len(value) not in (4, 5):
        raise ValueError(f"{value!r:.40} is not a run")
    row, column, length = (_integer(part, MAX_CELLS) for part in value[:3])
    flag, was = (None if part is None else _integer(part, max(MapFlag)) for part in (*value[3:], None)[:2])
    return Run(row, column, length, flag, was)


def runs_of(value: Any) -> list[Run]:
    """Check the runs of a call."""
    if not isinstance(value, list) or not 1 <= len(value) <= MOST_RUNS:
        raise ValueError(f"must be 1 to {MOST_RUNS} runs")
    try:
        runs = [_run(entry) for entry in value]
    except ValueError as err:
        raise ValueError(f"must be runs [row, column, length, flag]: {err}") from None
    if sum(run.length for run in runs) > MOST_CELLS:
        raise ValueError(f"must have at most {MOST_CELLS} cells")
    return runs


def size_of(value: Any) -> tuple[int, int]:
    """Check the size of a map."""
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError("must be [width, height] of the map")
    return _integer(value[0], MAX_CELLS), _integer(value[1], MAX_CELLS)


def paint(grid: MapGrid2D, runs: Iterable[Run]) -> list[Run]:
    """Change the flags of a map; return the runs that undo it. Raises `VerbError` if a run is outside the map."""
    undo: list[Run] = []
    for run in runs:
        end = run.column + run.length
        if run.row >= grid.height() or end > grid.width():
            raise VerbError(
                f"row {run.row}, columns {run.column} to {end}: the map has {grid.width()} x {grid.height()}"
            )
        cells = grid.flags[run.row, run.column : end]
        occupancy = grid.occupancy[run.row, run.column : end]
        wanted = flags_of(occupancy) if run.flag is None else np.full_like(cells, run.flag)
        changes = cells != wanted
        if run.was is not None:
            changes &= cells == run.was
        undo.extend(
            Run(run.row, run.column + first, last - first, int(cells[first]), int(wanted[first]))
            for first, last in _equal_runs(np.where(changes, cells * np.uint8(8) + wanted, np.uint8(255)))
        )
        if len(undo) > MOST_PIECES:
            raise VerbError(f"the change has more than {MOST_PIECES} pieces; paint less at once")
        cells[changes] = wanted[changes]
    return undo[::-1]  # the last change is undone first, because runs of one call may overlap


def _equal_runs(marks: np.ndarray[Any, np.dtype[np.uint8]]) -> Iterator[tuple[int, int]]:
    """Yield the first and the end index of runs of equal marks; 255 is skipped."""
    edges = [0, *(np.flatnonzero(marks[1:] != marks[:-1]) + 1).tolist(), len(marks)]
    for first, last in pairwise(edges):
        if last > first and marks[first] != 255:
            yield first, last


class Painter:
    """The verb ``paint_flags``, which runs on threads that may block.

    Args:
        store: returns the store; raises `StoreError` if there is none.
        changed: called after each change.
    """

    def __init__(self, store: Callable[[], StoreClient], changed: Callable[[], None]) -> None:
        self._store, self._changed = store, changed
        self._painting = threading.Lock()  # pages wait here instead of retrying

    def verbs(self) -> dict[str, PageVerb]:
        """Return the verb by its name."""
        return {"paint_flags": PageVerb(self._paint, {"map": name_of, "size": size_of, "runs": runs_of}, {})}

    def _paint(self, map: str, size: tuple[int, int], runs: Sequence[Run]) -> dict[str, Any]:  # noqa: A002
        store = self._store()
        undo: list[Run] = []

        def make_writes() -> list[Write[Any]]:
            grid = store.get(MAP, map)
            if grid is None:
                raise VerbError(f"no map {map!r} in the store; existing maps: {', '.join(store.names(MAP)) or 'none'}")
            if grid.getSize_in_cells() != size:
                raise VerbError(f"the size of the map {map!r} has changed: {grid.width()} x {grid.height()} cells")
            undo[:] = paint(grid, runs)
            return [Write(MAP, map, grid)] if undo else []

        with self._painting:
            store.change(make_writes)
        if undo:
            self._changed()
        return {"changed": sum(run.length for run in undo), "undo": [list(run) for run in undo]}
