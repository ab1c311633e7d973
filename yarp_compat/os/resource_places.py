"""YARP's resource folders, and the search for a file in them.

The search order follows YARP's ResourceFinder.cpp: the current directory, the main configuration file's
folder, the robot, the contexts, the user's folders, the administrator's, the installed ones, ``path.d``. As in YARP,
the name is appended to the folder unchanged, even ``./map.txt`` and ``maps/``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from yarp_compat.naming.directories import Directories
from yarp_compat.os import config_text
from yarp_compat.wire.values import entry_values


@dataclass(eq=False)
class ResourceFinderOptions:
    """Where to search, and what to return. Attributes and values are YARP's."""

    NoLocation = 0x0000
    Directory = 0x0001
    Context = 0x0002
    Robot = 0x0004
    User = 0x0008
    Sysadmin = 0x0010
    Installed = 0x0020
    NearMainConfig = 0x0040
    ClassicContext = 0x1000
    Default = User | Sysadmin | Installed
    ModuleDefault = Default | Robot | Context | Directory | ClassicContext | NearMainConfig

    First = 0
    All = 1

    ConfigLike = 0x0001
    DataLike = 0x0002
    ConfigAndDataLike = ConfigLike | DataLike

    ShowNone = 0x0000
    ShowDirectories = 0x0001
    ShowErrors = 0x0002
    ShowFromFlags = 0x0004
    ShowAll = ShowDirectories | ShowErrors

    searchLocations: int = ModuleDefault
    duplicateFilesPolicy: int = First
    searchFlavor: int = ConfigAndDataLike
    resourceType: str = ""
    messageFilter: int = ShowFromFlags

    @classmethod
    def findFirstMatch(cls) -> ResourceFinderOptions:
        """Return options for the first match."""
        return cls()

    @classmethod
    def findAllMatch(cls) -> ResourceFinderOptions:
        """Return options for every match."""
        return cls(cls.ModuleDefault, cls.All)


class ResourceSearch:
    """A search for files in YARP's directories and the contexts.

    Attributes:
        main_folder: the folder of the main configuration file; "" if unknown.
        near_main: whether that file is in the current directory; its folder is then searched instead of the contexts.
    """

    def __init__(self, contexts: Sequence[str] = ()) -> None:
        self.directories = Directories()
        self.contexts = list(contexts)
        self.main_folder = ""
        self.near_main = False

    def copy(self) -> ResourceSearch:
        """Return a copy of this search."""
        copy = ResourceSearch(self.contexts)
        copy.main_folder, copy.near_main = self.main_folder, self.near_main
        return copy

    def find_main(self, name: str) -> str:
        """Return the path of the main configuration file, "" if not found; record its folder for later searches."""
        found_path = self.first(name, ResourceFinderOptions())
        self.near_main = bool(found_path) and found_path == (
            name if is_absolute(name) else _append(_current_folder(), name)
        )
        path = (found_path or name).replace(os.sep, "/")
        self.main_folder = path.rpartition("/")[0]
        return found_path

    def first(self, name: str, options: ResourceFinderOptions, *, folder: bool = False) -> str:
        """Return the best existing path, or ""; ``folder``: search for a folder."""
        return next(self.paths(name, options, folder=folder), "")

    def paths(self, name: str, options: ResourceFinderOptions, *, folder: bool = False) -> Iterator[str]:
        """Yield each existing path once, best first; only the first one if the options request it."""
        seen = set()
        for path in self._candidates(name, options, folder):
            if path not in seen and os.path.exists(path):  # noqa: PTH110 - a Path would normalize it
                seen.add(path)
                yield path
                if options.duplicateFilesPolicy == ResourceFinderOptions.First:
                    return

    def _candidates(self, name: str, options: ResourceFinderOptions, folder: bool) -> Iterator[str]:
        if folder and not name and options.searchLocations & ResourceFinderOptions.Directory:
            yield _current_folder()
        for place in self.places(options):
            yield name if is_absolute(name) else _append(place, name)

    def places(self, options: ResourceFinderOptions) -> Iterator[str]:
        """Yield the folders to search, best first."""
        locations, flavor, o, kind = (
            options.searchLocations,
            options.searchFlavor,
            ResourceFinderOptions,
            options.resourceType,
        )
        if locations & o.Directory:
            yield kind if _is_rooted(kind) else _typed(_current_folder(), kind)
        if locations & o.NearMainConfig and self.near_main and self.main_folder:
            yield kind if _is_rooted(kind) else _typed(self.main_folder, kind)
        if locations & o.Robot:
            robots = ResourceFinderOptions(o.Default, o.All, resourceType="robots")
            yield from (_typed(path, kind) for path in self.paths(self.directories.robot(), robots))
        if locations & o.Context and not self.near_main:
            yield from (_typed(path, kind) for path in self.context_folders())
        if locations & o.User and flavor & o.ConfigLike and (home := self.directories.config_home()):
            yield _typed(home, kind)
        if locations & o.User and flavor & o.DataLike and (home := self.directories.data_home()):
            yield _typed(home, kind)
        if locations & o.Sysadmin:
            yield from (_typed(folder, kind) for folder in self.directories.config_dirs())
        if locations & o.Installed:
            yield from (_typed(folder, kind) for folder in self.directories.data_dirs())
            yield from (_typed(folder, kind) for folder in self._path_d())

    def context_folders(self) -> Iterator[str]:
        """Yield the existing folders of the contexts."""
        for context in self.contexts:
            every = ResourceFinderOptions(ResourceFinderOptions.Default, ResourceFinderOptions.All)
            yield from self.paths(_append("contexts", context), every)

    def home_of(self, kind: str, name: str) -> str:
        """Return the user's folder for a context or robot; a rooted name is the path itself."""
        if _is_rooted(name):
            return name
        folder = _append(self.directories.data_home(), kind)
        return _append(folder, name) if name else folder

    def _path_d(self) -> Iterator[str]:
        """Yield the folders in the packages' files ``config/path.d/*.ini``: ``[search NAME]`` with ``path /a /b``.

        Only the first of the installed data folders that has a folder ``config/path.d`` is searched.
        """
        places = (Path(folder, "config", "path.d") for folder in self.directories.data_dirs())
        place = next((folder for folder in places if folder.is_dir()), None)
        entries: config_text.Entries = {}
        if place is not None and config_text.read_file(str(place), entries, None, wipe=True):
            yield from _search_paths(entries)

    def place_names(self) -> str:
        """Return the folders to search, for log messages."""
        return ", ".join(self.places(ResourceFinderOptions()))


def _current_folder() -> str:
    return os.getcwd()  # noqa: PTH109 - as text


def _append(folder: str, name: str) -> str:
    """Append a name to a folder without normalizing either."""
    return f"{folder}{os.sep}{name}"


def _typed(folder: str, kind: str) -> str:
    """Return the subfolder for one kind of resources."""
    if not kind:
        return folder
    return f"{folder}{kind}" if folder.endswith(os.sep) else _append(folder, kind)


def find_in_context(context: str, name: str) -> str:
    """Return the path of a file, searched in a context; "" if not found."""
    return ResourceSearch([context] if context else []).first(name, ResourceFinderOptions())


def _search_paths(entries: config_text.Entries) -> Iterator[str]:
    for name in entry_values(entries.get("search", ())):
        groups = entry_values(entries.get(name, ())) if isinstance(name, str) else ()
        paths = next((group for group in groups if isinstance(group, list) and group[:1] == ["path"]), [])
        yield from (path for path in paths[1:] if isinstance(path, str))


def is_absolute(name: str) -> bool:
    """Return whether a path begins with a root or a drive, on any system."""
    return name.startswith(("/", "\\")) or name[1:2] == ":"


def _is_rooted(name: str) -> bool:
    """Return whether a path is absolute, or begins with the current directory."""
    return bool(name) and (is_absolute(name) or name == "." or name[:2] in ("./", ".\\"))
