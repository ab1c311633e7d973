"""Names of maps, locations and the like: they stand in zenoh keys as they are, and tell no path."""

from __future__ import annotations

from bridge.stores.errors import StoreError

MAX_NAME = 254
"""Bytes; YARP's longest name of a map (MapGrid2D::read)."""

_FORBIDDEN = frozenset("/\\*$?#%")
"""Separators of paths and keys, and what zenoh's key expressions and selectors use."""


def check_name(name: str) -> str:
    """Return a name that can stand in the store, or raise `StoreError`."""
    size = len(name.encode(errors="replace"))
    if not 0 < size <= MAX_NAME:
        msg = f"the name {name[:40]!r} has {size} bytes; a name has 1 to {MAX_NAME}"
    elif not name.isprintable():
        msg = f"the name {name!r} has characters that cannot be printed"
    elif found := sorted(_FORBIDDEN & set(name)):
        msg = f"the name {name!r} has {' '.join(found)}; a name has none of {' '.join(sorted(_FORBIDDEN))}"
    elif name[0] in "@." or name != name.strip():
        msg = f"the name {name!r} begins with @ or a dot, or has blanks at its ends"
    else:
        return name
    raise StoreError(msg)
