"""Maps and places in files of the maps folder, for clients that save and load."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bridge.stores.kinds import AREA, BEHAVIOUR, LINK, LOCATION, MAP, OBJECT, PATH, ValueKind
from bridge.stores.store import Store, Write
from yarp_compat.dev.extras import Extras, extras_file
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.places import Places, load_maps, save_maps
from yarp_compat.file_names import forbidden

_LONGEST = 200


class MapsFolder:
    """Turns what a client calls a file into a path in one folder, never below it; made when something is written."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def file(self, name: str, *suffixes: str) -> Path:
        """The file of a name; without a suffix it gets the first of ``suffixes`` (``.yaml``), else it has one.

        Raises `ValueError` for a name that is not plain, or leads out of the folder; the text is for the client's user.
        """
        if not name or len(name.encode(errors="replace")) > _LONGEST or not name.isprintable():
            raise ValueError(f"{name[:60]!r} is no name of a file: it has 1 to {_LONGEST} bytes that can be printed")
        if name[0] == "." or any(sign in name for sign in "/\\:"):
            raise ValueError(
                f"{name[:60]!r} is refused: give the plain name of a file in the maps folder, without a path"
            )
        if why := forbidden(name):
            raise ValueError(f"{name[:60]!r} is refused: it {why}")
        if suffixes and not name.lower().endswith(suffixes):
            if "." in name:
                raise ValueError(f"{name[:60]!r} is refused: its name should end in {' or '.join(suffixes)}")
            name += suffixes[0]
        found = self.path / name
        if found.is_symlink() and not found.resolve().is_relative_to(self.path.resolve()):
            raise ValueError(f"{name[:60]!r} is refused: it is a link that leads out of the maps folder")
        return found

    def existing(self, name: str, *suffixes: str) -> Path:
        """As `file`, of one that is there, with a suffix if it has none; raises `FileNotFoundError`."""
        found = self.file(name, *suffixes)
        others = [found.with_name(name + suffix) for suffix in suffixes if found.name != name]
        for each in (found, *others):
            if each.is_file():
                return self.file(each.name, *suffixes)
        raise FileNotFoundError(f"there is no file {name!r} in the maps folder")

    def new(self, name: str, *suffixes: str) -> Path:
        """As :meth:`file`, of one that is to be written: the folder is there afterwards."""
        found = self.file(name, *suffixes)
        self.path.mkdir(parents=True, exist_ok=True)
        return found


_YARP, _ROS, _LIST = ".map", (".yaml", ".yml"), ".ini"
_PLACES: dict[str, ValueKind[Any]] = {"locations": LOCATION, "objects": OBJECT, "areas": AREA, "paths": PATH}


class MapFiles:
    """Writes the store into files, and reads it from them. All names are those of the maps folder.

    What is read takes the place of what has its name. ``maps`` and ``locations`` are what was imported at the start,
    wherever it is. All raise `ValueError` or `OSError` for the file's sake, and `StoreError` for the store's.
    """

    def __init__(self, folder: MapsFolder, store: Store, maps: Path | None, locations: Path | None) -> None:
        self._folder, self._store = folder, store
        self._start_maps, self._start_locations = maps, locations

    def save_map(
        self, name: str, file: str, *, image: str = "", mode: str = "", thresholds: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Write a map: as YARP keeps it where the file is called ``.map``, else as ROS does.

        ROS's format has images (pgm, png, bmp; "": pgm), modes (trinary, scale, raw; "": what the map needs) and
        thresholds for free and occupied (0: the usual ones).
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
        found: dict[ValueKind[Any], dict[str, Any]] = {kind: getattr(places, name) for name, kind in _PLACES.items()}
        found |= {BEHAVIOUR: extras.behaviours, LINK: extras.links}
        self._store.write(
            [Write(kind, name, value) for kind, values in found.items() for name, value in values.items()]
        )
