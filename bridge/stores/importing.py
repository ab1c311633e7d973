"""Files of maps and places into the store, at start or by hand, and out of it again."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from bridge.config.sections.store import StoreSection
from bridge.stores.errors import StoreError
from bridge.stores.kinds import AREA, BEHAVIOUR, CURRENT, LINK, LOCATION, MAP, OBJECT, PATH
from bridge.stores.names import check_name
from bridge.stores.replica import Body, Key
from bridge.stores.store import THE_MAP, Store, Write
from yarp_compat.dev.extras import Extras, extras_file
from yarp_compat.dev.mapcollection import load_maps
from yarp_compat.dev.mapfile import MapFileError, read_text
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.places import Places

_log = logging.getLogger(__name__)


def read_files(path: Path) -> list[Write[Any]]:
    """What a file holds: a map (``.map``, or YAML of ROS), a collection of maps, or places with what is beside them.

    Raises:
        StoreError: it cannot be read; the text says why.
    """
    try:
        if path.suffix.lower() != ".ini":
            grid = MapGrid2D.load(path)
            return [Write(MAP, grid.name or path.stem, grid)]
        if not read_text(path).lstrip().startswith("Version:"):
            return [Write(MAP, name, grid) for name, grid in load_maps(path).items()]
        places, beside = Places.load(path), extras_file(path)
        return places_writes(places, Extras.load(beside) if beside.exists() else Extras())
    except MapFileError as err:
        raise StoreError(str(err)) from None


def places_writes(places: Places, extras: Extras) -> list[Write[Any]]:
    """Places and what is beside them, as they are written into the store."""
    by_kind: list[tuple[Any, dict[str, Any]]] = [
        (LOCATION, places.locations),
        (OBJECT, places.objects),
        (AREA, places.areas),
        (PATH, places.paths),
        (BEHAVIOUR, extras.behaviours),
        (LINK, extras.links),
    ]
    return [Write(kind, name, value) for kind, values in by_kind for name, value in values.items()]


def import_at_start(store: Store, section: StoreSection) -> None:
    """Read the files that the configuration names; what the store knows, or had deleted, stays as it is.

    What is imported is older than anything that was ever written: a machine that joins a deployment with files of its
    own changes nothing there. A file that cannot be read is told in the log, and keeps nothing else from the store.
    """
    for key, path in (("maps", section.maps), ("locations", section.locations)):
        if path is None:
            continue
        try:
            writes = read_files(path)
            if key == "maps" and writes:
                writes.append(Write(CURRENT, THE_MAP, writes[0].name))
            changes: dict[Key, Body | None] = {
                (each.kind.name, check_name(each.name)): each.kind.encode(each.name, each.value)
                for each in writes
                if not store.replica.remembers(each.kind.name, each.name)
            }
            store.replica.write(changes, oldest=True)
        except StoreError as err:
            _log.error("store.%s: nothing of it is imported: %s", key, err)
        else:
            _log.info("store.%s: %d of %d values of %s are new", key, len(changes), len(writes), path)
