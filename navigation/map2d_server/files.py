"""Maps and places in files of the maps folder, for clients that save and load."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bridge.stores.kinds import AREA, BEHAVIOUR, LINK, LOCATION, MAP, OBJECT, PATH, Kind
from bridge.stores.store import Store, Write
from navigation.map2d_server.folder import MapsFolder
from yarp_compat.dev.extras import Extras, extras_file
from yarp_compat.dev.mapcollection import load_maps, save_maps
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.places import Places

_YARP, _ROS, _LIST = ".map", (".yaml", ".yml"), ".ini"
_PLACES: dict[str, Kind[Any]] = {"locations": LOCATION, "objects": OBJECT, "areas": AREA, "paths": PATH}


class MapFiles:
    """Writes the store into files, and reads it from them. All names are those of the maps folder.

    What is read takes the place of what has its name. All raise `ValueError` or `OSError` for the file's sake, and
    `StoreError` for the store's.

    Args:
        folder: where the files are.
        store: what is written and read.
        maps: the collection that was imported at the start, wherever it is; None for none.
        locations: the file of places that was, likewise.
    """

    def __init__(self, folder: MapsFolder, store: Store, maps: Path | None, locations: Path | None) -> None:
        self._folder, self._store = folder, store
        self._start_maps, self._start_locations = maps, locations

    def save_map(
        self, name: str, file: str, *, image: str = "", mode: str = "", thresholds: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Write a map: as YARP keeps it where the file is called ``.map``, else as ROS does.

        Args:
            name: the map's.
            file: a name in the maps folder.
            image: of ROS's format: pgm, png or bmp; "" for pgm.
            mode: of ROS's format: trinary, scale or raw; "" for what the map needs.
            thresholds: of ROS's format, for free and occupied; 0 for the usual ones.
        """
        grid = self._store.get(MAP, name)
        if grid is None:
            raise ValueError(f"there is no map {name!r}")
        path = self._folder.new(file, *_ROS, _YARP)
        if path.suffix.lower() == _YARP:
            grid.save(path)
            return
        free, occupied = thresholds
        limits = {"free_thresh": free or 0.196, "occupied_thresh": occupied or 0.65}
        grid.save(path, image=image or "pgm", mode=mode, **limits)

    def load_map(self, file: str) -> MapGrid2D:
        """Read a map into the store."""
        grid = MapGrid2D.load(self._folder.existing(file, _YARP, *_ROS), jail=self._folder.path)
        self._store.put(MAP, grid.name, grid)
        return grid

    def save_collection(self, file: str) -> None:
        """Write all maps, and their list."""
        path = self._folder.new(file, _LIST)
        save_maps(self._store.all(MAP), path)

    def load_collection(self, file: str) -> None:
        """Read the maps of a list."""
        self._take_maps(self._folder.existing(file, _LIST), self._folder.path)

    def reload_collection(self) -> None:
        """Read the maps of the start again."""
        if self._start_maps is None:
            raise ValueError("no collection of maps is imported at the start (store.maps)")
        self._take_maps(self._start_maps, None)

    def save_places(self, file: str) -> None:
        """Write all locations, objects, areas and paths; behaviours and links into a file beside it."""
        places = Places()
        for attribute, kind in _PLACES.items():
            getattr(places, attribute).update(self._store.all(kind))
        path = self._folder.new(file, _LIST)
        places.save(path)
        extras = Extras(self._store.all(BEHAVIOUR), self._store.all(LINK))
        if extras.behaviours or extras.links or extras_file(path).exists():
            extras.save(extras_file(path))

    def load_places(self, file: str) -> None:
        """Read locations, objects, areas and paths."""
        self._take_places(self._folder.existing(file, _LIST), self._folder.path)

    def reload_places(self) -> None:
        """Read the places of the start again."""
        if self._start_locations is None:
            raise ValueError("no file of locations is imported at the start (store.locations)")
        self._take_places(self._start_locations, None)

    def _take_maps(self, path: Path, jail: Path | None) -> None:
        maps = load_maps(path, jail) if path.suffix == _LIST else [MapGrid2D.load(path, jail)]
        grids = maps.values() if isinstance(maps, dict) else maps
        self._store.write([Write(MAP, grid.name, grid) for grid in grids])

    def _take_places(self, path: Path, jail: Path | None) -> None:
        places, beside = Places.load(path, jail), extras_file(path)
        extras = Extras.load(beside, jail) if beside.exists() else Extras()
        found: dict[Kind[Any], dict[str, Any]] = {kind: getattr(places, name) for name, kind in _PLACES.items()}
        found |= {BEHAVIOUR: extras.behaviours, LINK: extras.links}
        self._store.write(
            [Write(kind, name, value) for kind, values in found.items() for name, value in values.items()]
        )
