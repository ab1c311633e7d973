"""Files with maps and places in the maps folder, for clients that save and load."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bridge.stores.kinds import AREA, BEHAVIOR, LINK, LOCATION, MAP, OBJECT, PATH, ValueKind
from bridge.stores.store import Store, Write
from yarp_compat.dev.extras import Extras, extras_file
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.places import Places, load_maps, save_maps
from yarp_compat.file_names import forbidden

_LONGEST = 200


class MapsFolder:
    """Converts clients' file names to paths in one folder, never below it; the first write creates the folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def file(self, name: str, *suffixes: str) -> Path:
        """Return the path of a name, which must have one of ``suffixes`` (such as ``.yaml``) or gets the first one.

        Raises `ValueError`, with a text for the client's user, for a name that is not plain, or that leaves the folder.
        """
        if not name or len(name.encode(errors="replace")) > _LONGEST or not name.isprintable():
            raise ValueError(f"invalid file name {name[:60]!r}: it must have 1 to {_LONGEST} printable bytes")
        if name[0] == "." or any(sign in name for sign in "/\\:"):
            raise ValueError(
                f"{name[:60]!r} is refused: give the plain name of a file in the maps folder, without a path"
            )
        if problem := forbidden(name):
            raise ValueError(f"{name[:60]!r} is refused: it {problem}")
        if suffixes and not name.lower().endswith(suffixes):
            if "." in name:
                raise ValueError(f"{name[:60]!r} is refused: its name must end in {' or '.join(suffixes)}")
            name += suffixes[0]
        path = self.path / name
        if path.is_symlink() and not path.resolve().is_relative_to(self.path.resolve()):
            raise ValueError(f"{name[:60]!r} is refused: it is a link out of the maps folder")
        return path

    def existing(self, name: str, *suffixes: str) -> Path:
        """Return the path of an existing file, by the rules of `file`; raises `FileNotFoundError`."""
        path = self.file(name, *suffixes)
        others = [path.with_name(name + suffix) for suffix in suffixes if path.name != name]
        for candidate in (path, *others):
            if candidate.is_file():
                return self.file(candidate.name, *suffixes)
        raise FileNotFoundError(f"no file {name!r} in the maps folder")

    def new(self, name: str, *suffixes: str) -> Path:
        """Return the path of a file to write, by the rules of :meth:`file`, and create the folder."""
        path = self.file(name, *suffixes)
        self.path.mkdir(parents=True, exist_ok=True)
        return path


_YARP, _ROS, _LIST = ".map", (".yaml", ".yml"), ".ini"
_PLACES: dict[str, ValueKind[Any]] = {"locations": LOCATION, "objects": OBJECT, "areas": AREA, "paths": PATH}


class MapFiles:
    """Saves the store to files, and loads it from them. All names are those of files in the maps folder.

    Loaded values replace values with the same names. ``maps`` and ``locations`` are the files that were imported at the
    start, in any folder. All methods raise `ValueError` or `OSError` for files, and `StoreError` for the store.
    """

    def __init__(self, folder: MapsFolder, store: Store, maps: Path | None, locations: Path | None) -> None:
        self._folder, self._store = folder, store
        self._start_maps, self._start_locations = maps, locations

    def save_map(
        self, name: str, file: str, *, image: str = "", mode: str = "", thresholds: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Save a map, in YARP's format if the file ends in ``.map``, else in the ROS format.

        ROS's format has images (pgm, png, bmp; "" for pgm), modes (trinary, scale, raw; "" for what the map needs) and
        thresholds for free and occupied (0 for the defaults).
        """
        grid = self._store.get(MAP, name)
        if grid is None:
            raise ValueError(f"no map {name!r}")
        path = self._folder.new(file, *_ROS, _YARP)
        if path.suffix.lower() == _YARP:
            grid.save(path)
            return
        free, occupied = thresholds
        limits = {"free_thresh": free or 0.196, "occupied_thresh": occupied or 0.65}
        grid.save(path, image=image or "pgm", mode=mode, **limits)

    def load_map(self, file: str) -> MapGrid2D:
        """Load a map into the store."""
        grid = MapGrid2D.load(self._folder.existing(file, _YARP, *_ROS), jail=self._folder.path)
        self._store.put(MAP, grid.name, grid)
        return grid

    def save_collection(self, file: str) -> None:
        """Save all maps, and their list."""
        path = self._folder.new(file, _LIST)
        save_maps(self._store.all(MAP), path)

    def load_collection(self, file: str) -> None:
        """Load the maps of a list file."""
        self._load_maps(self._folder.existing(file, _LIST), self._folder.path)

    def reload_collection(self) -> None:
        """Load again the maps that were imported at the start."""
        if self._start_maps is None:
            raise ValueError("no collection of maps was imported at the start (store.maps)")
        self._load_maps(self._start_maps, None)

    def save_places(self, file: str) -> None:
        """Save all locations, objects, areas and paths, and behaviors and links in a second file."""
        places = Places()
        for attribute, kind in _PLACES.items():
            getattr(places, attribute).update(self._store.all(kind))
        path = self._folder.new(file, _LIST)
        places.save(path)
        extras = Extras(self._store.all(BEHAVIOR), self._store.all(LINK))
        if extras.behaviors or extras.links or extras_file(path).exists():
            extras.save(extras_file(path))

    def load_places(self, file: str) -> None:
        """Load locations, objects, areas and paths, and behaviors and links from the second file if it exists."""
        self._load_places(self._folder.existing(file, _LIST), self._folder.path)

    def reload_places(self) -> None:
        """Load again the places that were imported at the start."""
        if self._start_locations is None:
            raise ValueError("no file of locations was imported at the start (store.locations)")
        self._load_places(self._start_locations, None)

    def _load_maps(self, path: Path, jail: Path | None) -> None:
        maps = load_maps(path, jail) if path.suffix == _LIST else [MapGrid2D.load(path, jail)]
        grids = maps.values() if isinstance(maps, dict) else maps
        self._store.write([Write(MAP, grid.name, grid) for grid in grids])

    def _load_places(self, path: Path, jail: Path | None) -> None:
        places, extras_path = Places.load(path, jail), extras_file(path)
        extras = Extras.load(extras_path, jail) if extras_path.exists() else Extras()
        by_kind: dict[ValueKind[Any], dict[str, Any]] = {kind: getattr(places, name) for name, kind in _PLACES.items()}
        by_kind |= {BEHAVIOR: extras.behaviors, LINK: extras.links}
        self._store.write(
            [Write(kind, name, value) for kind, values in by_kind.items() for name, value in values.items()]
        )
