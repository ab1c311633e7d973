"""Verbs for the places in the store: save, rename and delete locations, areas and paths."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from bridge.client.store import StoreClient
from bridge.stores.entry import check_name
from bridge.stores.kinds import AREA, LOCATION, PATH, ValueKind
from bridge.stores.store import Write
from bridge.web.verbs.verbs import MOST_NUMBER, PageVerb, VerbError, name_of, number_of, truth_of
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.sig.vec2d import Vec2D

MOST_CORNERS = 500
_SMALLEST = 1e-4
"""Square meters. An area's corners count as being on one line if no corner spans a larger parallelogram with
the first corner and the corner farthest from the first."""

_KINDS: dict[str, ValueKind[Any]] = {kind.name: kind for kind in (LOCATION, AREA, PATH)}
_WORDS = {LOCATION.name: "place", AREA.name: "area", PATH.name: "path"}

Corners = list[tuple[float, float]]


def kind_of(value: Any) -> ValueKind[Any]:
    """Check a kind of places."""
    if not isinstance(value, str) or value not in _KINDS:
        raise ValueError(f"must be one of {', '.join(_KINDS)}")
    return _KINDS[value]


def corners_of(value: Any) -> Corners:
    """Check the corners of an area."""
    if not isinstance(value, list) or not 3 <= len(value) <= MOST_CORNERS:
        raise ValueError(f"must be 3 to {MOST_CORNERS} corners")
    try:
        corners = [(number_of(x), number_of(y)) for x, y in value]
    except (TypeError, ValueError):
        limits = f"between {-MOST_NUMBER:,.15g} and {MOST_NUMBER:,.15g}"
        raise ValueError(f"must be corners [x, y], in meters {limits}") from None
    if _on_a_line(corners):
        raise ValueError("must be corners that enclose an area, not all on one line")
    return corners


def _on_a_line(corners: Corners) -> bool:
    """Return whether all corners are on one line, or nearly so."""
    first = corners[0]
    far = max(corners, key=lambda corner: math.dist(first, corner))
    across, up = far[0] - first[0], far[1] - first[1]
    return max(abs(across * (y - first[1]) - up * (x - first[0])) for x, y in corners) < _SMALLEST


class PlaceVerbs:
    """The verbs for places, which run on threads that may block.

    Args:
        store: returns the store; raises `StoreError` if none is known.
        changed: called after each change.
    """

    def __init__(self, store: Callable[[], StoreClient], changed: Callable[[], None]) -> None:
        self._store, self._changed = store, changed

    def verbs(self) -> dict[str, PageVerb]:
        """Return the verbs by name."""
        named, kind, again = {"name": name_of}, {"kind": kind_of}, {"replace": truth_of}
        pose = dict.fromkeys(("x", "y", "theta"), number_of)
        return {
            "keep_place": PageVerb(self._keep_place, {**named, **pose}, again),
            "keep_area": PageVerb(self._keep_area, {**named, "points": corners_of}, again),
            "delete_place": PageVerb(self._delete, named, kind),
            "rename_place": PageVerb(self._rename, {**named, "to": name_of}, kind),
        }

    def _keep_place(self, name: str, x: float, y: float, theta: float, *, replace: bool = False) -> str:
        def location(map_name: str) -> Write[Any]:
            return Write(LOCATION, name, Map2DLocation(map_name, x, y, math.degrees(theta)))

        return self._keep(LOCATION, name, location, replace=replace)

    def _keep_area(self, name: str, points: Corners, *, replace: bool = False) -> str:
        def area(map_name: str) -> Write[Any]:
            if not map_name:
                raise VerbError("no current map; choose the area's map")
            return Write(AREA, name, Map2DArea(map_name, [Vec2D(*point) for point in points]))

        return self._keep(AREA, name, area, replace=replace)

    def _keep(self, kind: ValueKind[Any], name: str, make: Callable[[str], Write[Any]], *, replace: bool) -> str:
        store = self._store()
        check_name(name)

        def writes() -> Sequence[Write[Any]]:
            if not replace and name in store.names(kind):
                raise VerbError(f"the {_WORDS[kind.name]} {name!r} exists already")
            return [make(store.current_map())]

        store.change(writes)
        self._changed()
        return f"saved {name}"

    def _delete(self, name: str, kind: ValueKind[Any] = LOCATION) -> str:
        store = self._store()
        if name not in store.names(kind):
            raise VerbError(f"unknown {_WORDS[kind.name]} {name!r}")
        store.write([Write(kind, name, None)])
        self._changed()
        return f"deleted {name}"

    def _rename(self, name: str, to: str, kind: ValueKind[Any] = LOCATION) -> str:
        self._store().rename(kind, name, to)
        self._changed()
        return f"renamed {name} to {to}"
