"""The places where YARP's programs keep their files, and the search for a file in them.

The directories are those of YARP 3.5 and later (yarp/conf/dirs.h): ``YARP_DATA_HOME`` and its kin name the directory
itself; the XDG variables (APPDATA and ALLUSERSPROFILE on Windows) name one in which ``yarp`` is looked for. The order
of the search is that of YARP's ResourceFinder.cpp: the current directory, beside the main configuration file, the
robot, the contexts, the user's own folders, the administrator's, the installed ones, ``path.d``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from yarp_compat.naming.config import folder
from yarp_compat.os import config_text
from yarp_compat.wire.values import entry_values


@dataclass(frozen=True)
class Directories:
    """YARP's directories, by the variables of an environment on a platform as `sys.platform` names it."""

    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    platform: str = sys.platform

    def data_home(self) -> Path:
        """The user's own data: contexts and robots that were edited."""
        home = self._home()
        own = {"win32": home / "AppData" / "Roaming", "darwin": home / "Library" / "Application Support"}
        default = own.get(self.platform, home / ".local" / "share")
        if self.environment.get("YARP_DATA_HOME"):
            return Path(self.environment["YARP_DATA_HOME"])
        return Path(self.environment.get(self._variable("APPDATA", "XDG_DATA_HOME")) or default) / "yarp"

    def config_home(self) -> Path:
        """The user's own settings: ``yarp.conf`` and its kin."""
        return Path(folder(self.environment, self.platform))

    def data_dirs(self) -> list[Path]:
        """The folders of what is installed for everybody."""
        default = "C:\\ProgramData" if self.platform == "win32" else "/usr/local/share:/usr/share"
        return self._many("YARP_DATA_DIRS", self._variable("ALLUSERSPROFILE", "XDG_DATA_DIRS"), default, "yarp")

    def config_dirs(self) -> list[Path]:
        """The folders of what the administrator set."""
        default = {"win32": "C:\\ProgramData", "darwin": "/etc:/Library/Preferences"}.get(self.platform, "/etc/xdg")
        variable = self._variable("ALLUSERSPROFILE", "XDG_CONFIG_DIRS")
        return self._many("YARP_CONFIG_DIRS", variable, default, self._config_suffix())

    def robot(self) -> str:
        """The robot's name: ``YARP_ROBOT_NAME``, or ``default``."""
        return self.environment.get("YARP_ROBOT_NAME", "default")

    def _home(self) -> Path:
        return Path(self.environment.get("USERPROFILE" if self.platform == "win32" else "HOME", ""))

    def _variable(self, windows: str, linux: str) -> str:
        # macOS has no such variable: its directories are fixed.
        return {"win32": windows, "darwin": ""}.get(self.platform, linux)

    def _config_suffix(self) -> str:
        return "yarp/config" if self.platform == "win32" else "yarp"

    def _many(self, own: str, variable: str, default: str, suffix: str) -> list[Path]:
        separator = ";" if self.platform == "win32" else ":"
        if self.environment.get(own):
            return [Path(part) for part in self.environment[own].split(separator) if part]
        return [Path(part) / suffix for part in (self.environment.get(variable) or default).split(separator) if part]


@dataclass(eq=False)
class ResourceFinderOptions:
    """Where to look, and what to return. Attributes and values as YARP's."""

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
        """Options that return the first file found."""
        return cls()

    @classmethod
    def findAllMatch(cls) -> ResourceFinderOptions:
        """Options that return every file found."""
        return cls(cls.ModuleDefault, cls.All)


class ResourceSearch:
    """Searches for files in YARP's directories and the contexts.

    Attributes:
        main_folder: the folder of the main configuration file; empty where that is not known.
        near_main: that file was found in the current directory, so that others are looked for beside it.
    """

    def __init__(self, contexts: Sequence[str] = ()) -> None:
        self.directories = Directories()
        self.contexts = list(contexts)
        self.main_folder = ""
        self.near_main = False

    def copy(self) -> ResourceSearch:
        """Another of the same state."""
        made = ResourceSearch(self.contexts)
        made.main_folder, made.near_main = self.main_folder, self.near_main
        return made

    def find_main(self, name: str) -> str:
        """The path of the main configuration file, beside which others are looked for; empty where it is not found."""
        found = self.first(name, ResourceFinderOptions())
        self.near_main = bool(found) and Path(found) == Path.cwd() / name
        path = found or name
        self.main_folder = str(Path(path).parent) if "/" in path or os.sep in path else ""
        return found

    def first(self, name: str, options: ResourceFinderOptions) -> str:
        """The best path that exists, or empty."""
        return next(self.paths(name, options), "")

    def paths(self, name: str, options: ResourceFinderOptions) -> Iterator[str]:
        """Every path that exists, best first, each once; only the first where the options say so."""
        seen = set()
        if Path(name).is_absolute() or _is_windows_absolute(name):
            places: Sequence[str] | Iterator[str] = [""]
        else:
            places = self.places(options)
        for place in places:
            path = str(Path(place) / options.resourceType / name) if place else name
            if path not in seen and Path(path).exists():
                seen.add(path)
                yield path
                if options.duplicateFilesPolicy == ResourceFinderOptions.First:
                    return

    def places(self, options: ResourceFinderOptions) -> Iterator[str]:
        """The folders to look in, best first."""
        where, flavor, o = options.searchLocations, options.searchFlavor, ResourceFinderOptions
        if where & o.Directory:
            yield str(Path.cwd())
        if where & o.NearMainConfig and self.near_main and self.main_folder:
            yield self.main_folder
        if where & o.Robot:
            yield from self._existing("robots", self.directories.robot())
        if where & o.Context and not self.near_main:
            yield from self.context_folders()
        if where & o.User and flavor & o.ConfigLike:
            yield str(self.directories.config_home())
        if where & o.User and flavor & o.DataLike:
            yield str(self.directories.data_home())
        if where & o.Sysadmin:
            yield from map(str, self.directories.config_dirs())
        if where & o.Installed:
            yield from map(str, self.directories.data_dirs())
            yield from self._path_d()

    def context_folders(self) -> Iterator[str]:
        """The folders of the contexts that are there."""
        for context in self.contexts:
            yield from self._existing("contexts", context)

    def _existing(self, kind: str, name: str) -> Iterator[str]:
        for place in self.places(ResourceFinderOptions(ResourceFinderOptions.Default)):
            path = Path(place) / kind / name
            if path.is_dir():
                yield str(path)

    def _path_d(self) -> Iterator[str]:
        """Folders that packages added by files ``config/path.d/*.ini``: ``[search NAME]`` with ``path /a /b``."""
        for place in self.directories.data_dirs():
            for file in sorted((place / "config" / "path.d").glob("*.ini")):
                found: config_text.Entries = {}
                if config_text.read_file(str(file), found, None, wipe=True):
                    yield from _search_paths(found)

    def said_places(self) -> str:
        """The folders to look in, for people."""
        return ", ".join(self.places(ResourceFinderOptions()))


def find_in_context(context: str, name: str) -> str:
    """The path of a file that is looked for in a context; empty where it is not found."""
    return ResourceSearch([context] if context else []).first(name, ResourceFinderOptions())


def _search_paths(found: config_text.Entries) -> Iterator[str]:
    for name in entry_values(found.get("search", ())):
        groups = entry_values(found.get(name, ())) if isinstance(name, str) else ()
        paths = next((group for group in groups if isinstance(group, list) and group[:1] == ["path"]), [])
        yield from (path for path in paths[1:] if isinstance(path, str))


def _is_windows_absolute(name: str) -> bool:
    return name[:1] in ("/", "\\") or name[1:2] == ":"
