"""``ResourceFinder``: finds a program's configuration and data files, and reads its command line.

The order of the places is that of YARP's ResourceFinder.cpp: the current directory, beside the main configuration file,
the robot, the contexts, the user's own folders, the administrator's, the installed ones, ``path.d``.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from yarp_compat.os.bottle import Bottle
from yarp_compat.os.dirs import Directories
from yarp_compat.os.property import Property
from yarp_compat.os.searchable import Searchable
from yarp_compat.os.value import Value

log = logging.getLogger("yarp.os.ResourceFinder")


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

    def __init__(
        self,
        searchLocations: int = ModuleDefault,
        duplicateFilesPolicy: int = First,
        searchFlavor: int = ConfigAndDataLike,
        resourceType: str = "",
        messageFilter: int = ShowFromFlags,
    ) -> None:
        self.searchLocations = searchLocations
        self.duplicateFilesPolicy = duplicateFilesPolicy
        self.searchFlavor = searchFlavor
        self.resourceType = resourceType
        self.messageFilter = messageFilter

    @classmethod
    def findFirstMatch(cls) -> ResourceFinderOptions:
        """Options that return the first file found."""
        return cls()

    @classmethod
    def findAllMatch(cls) -> ResourceFinderOptions:
        """Options that return every file found."""
        return cls(cls.ModuleDefault, cls.All)


class ResourceFinder(Searchable):
    """Finds files by name in the places where YARP programs keep them.

    Example::

        rf = yarp.ResourceFinder()
        rf.setDefaultContext("navigation")
        rf.setDefaultConfigFile("robot.ini")
        rf.configure(sys.argv)                 # --from, --context and everything else
        period = rf.check("period", yarp.Value(0.02)).asFloat64()
    """

    _singleton: ResourceFinder | None = None

    def __init__(self, other: ResourceFinder | None = None) -> None:
        self._directories = Directories()
        self._property = Property()
        self._contexts: list[str] = []
        self._main_folder = ""
        self._near_main = False
        self._configured = False
        self._null = False
        if other is not None:
            self._property.fromString(other._property.toString())
            self._contexts = list(other._contexts)
            self._main_folder, self._near_main = other._main_folder, other._near_main
            self._configured, self._null = other._configured, other._null

    @classmethod
    def getResourceFinderSingleton(cls) -> ResourceFinder:
        """The one of the program."""
        if cls._singleton is None:
            cls._singleton = cls()
        return cls._singleton

    def configure(self, *args: Any) -> bool:
        """Read a command line: ``configure(sys.argv)``, its first word skipped unless a second argument says False.

        The older forms ``configure(argc, argv)`` and ``configure(policy, argv)`` are taken too.

        Returns:
            False when a file given by ``--from`` cannot be read.
        """
        words, skip = self._command_line(args)
        self._configured = True
        given = Property()
        given.fromCommand(words, skip)
        if given.check("context"):
            self._contexts = [given.find("context").asString()]
        self._property.fromCommand(words, skip, False)
        if not self._property.check("from"):
            return True
        name = self._property.find("from").toString().strip('"')
        found = self._find_main(name)
        read = self._property.fromConfigFile(found or name, False)
        if not read:
            log.warning("the configuration file %s cannot be read (looked for in %s)", name, self._said_places())
        self._property.fromCommand(words, skip, False)  # the command line outranks the file
        return bool(read) or not given.check("from")

    @staticmethod
    def _command_line(args: tuple[Any, ...]) -> tuple[list[str], bool]:
        rest = [arg for arg in args if not isinstance(arg, str) and (isinstance(arg, bool) or not isinstance(arg, int))]
        if not rest or isinstance(rest[0], bool):
            msg = "ResourceFinder.configure takes a list of words, as in configure(sys.argv)"
            raise TypeError(msg)
        return [str(word) for word in rest[0]], bool(rest[1]) if len(rest) > 1 else True

    def _find_main(self, name: str) -> str:
        found = self._first(name, ResourceFinderOptions())
        self._near_main = bool(found) and Path(found) == Path.cwd() / name
        self._main_folder = (
            str(Path(found or name).parent) if "/" in (found or name) or os.sep in (found or name) else ""
        )
        return found

    def isConfigured(self) -> bool:
        """Whether `configure` was called."""
        return self._configured

    def setDefaultContext(self, context: str) -> bool:
        """The context to look in unless the command line says another."""
        self._contexts = [context] if context else []
        return True

    def setDefaultConfigFile(self, name: str) -> bool:
        """The configuration file to read unless the command line says another."""
        return self.setDefault("from", name)

    def setDefault(self, key: str, value: Any) -> bool:
        """A value to use unless the command line or the configuration file says another."""
        if not self._property.check(key):
            self._property.put(key, _from_text(value) if isinstance(value, str) else value)
        return True

    def setVerbose(self, verbose: bool = True) -> bool:
        """Show each place looked in."""
        log.setLevel(logging.DEBUG if verbose else logging.INFO)
        return True

    def setQuiet(self, quiet: bool = True) -> bool:
        """Show warnings only."""
        log.setLevel(logging.WARNING if quiet else logging.INFO)
        return True

    def find(self, key: str) -> Value:
        """The value of a key; a null value when there is none."""
        return self._property.find(key)

    def findGroup(self, key: str) -> Bottle:
        """The group of a key; a null bottle when there is none."""
        return self._property.findGroup(key)

    def findNestedResourceFinder(self, key: str) -> ResourceFinder:
        """A finder over a group's keys, in the same places."""
        nested = ResourceFinder(self)
        group = self.findGroup(key)
        nested._property = Property()
        nested._property.fromString(group.toString())
        nested._null = group.isNull()
        nested._configured = True
        return nested

    def isNull(self) -> bool:
        """Whether this is the finder over a group that does not exist."""
        return self._null

    def toString(self) -> str:
        """All keys as a Bottle's text."""
        return self._property.toString()

    def getContext(self) -> str:
        """The context that is looked in, or empty."""
        return self._contexts[0] if self._contexts else ""

    def getContexts(self) -> Bottle:
        """The contexts that are looked in."""
        return _strings(self._contexts)

    def findFile(self, name: str, options: ResourceFinderOptions | None = None) -> str:
        """The path of a file, or of the file that the key ``name`` gives; empty when it is not found."""
        return self.findFileByName(self._meant(name), options)

    def findFileByName(self, name: str, options: ResourceFinderOptions | None = None) -> str:
        """The path of the file of this very name; empty when it is not found."""
        found = self._first(name, options or ResourceFinderOptions())
        if not found:
            log.debug("%s is not found in %s", name, self._said_places())
        return found

    def findPath(self, name: str = "", options: ResourceFinderOptions | None = None) -> str:
        """The path of a folder; without a name, the first place that is looked in."""
        return self._first(self._meant(name) if name else "", options or ResourceFinderOptions()) or (
            "" if name else str(Path.cwd())
        )

    def findPaths(self, name: str, options: ResourceFinderOptions | None = None) -> Bottle:
        """The paths of all folders or files of this name."""
        every = options or ResourceFinderOptions.findAllMatch()
        return _strings(self._search(self._meant(name), every))

    def getContextPath(self) -> str:
        """The folder of the context: the first that is found; empty when there is none."""
        return next(iter(self._context_folders()), "")

    def getHomeContextPath(self) -> str:
        """The folder for the context's files that the user changed; made when it is not there."""
        return self._home("contexts", self.getContext())

    def getHomeRobotPath(self) -> str:
        """The folder for the robot's files that the user changed; made when it is not there."""
        return self._home("robots", self._directories.robot())

    def readConfig(self, config: Property, key: str, options: ResourceFinderOptions) -> bool:
        """Read every file of a name into ``config``, those found first outranking the others."""
        paths = list(self._search(self._meant(key), options))
        for path in reversed(paths):
            config.fromConfigFile(path, False)
        return bool(paths)

    def _meant(self, name: str) -> str:
        return self._property.find(name).asString() if self._property.check(name) else name

    def _home(self, kind: str, name: str) -> str:
        if self._near_main:
            return self._main_folder
        path = self._directories.data_home() / kind / name
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as err:
            log.warning("the folder %s cannot be made: %s", path, err)
        return str(path)

    def _first(self, name: str, options: ResourceFinderOptions) -> str:
        return next(self._search(name, options), "")

    def _search(self, name: str, options: ResourceFinderOptions) -> Iterator[str]:
        """Every path that exists, best first, each once; only the first where the options say so."""
        seen = set()
        if Path(name).is_absolute() or _is_windows_absolute(name):
            places: Sequence[str] | Iterator[str] = [""]
        else:
            places = self._places(options)
        for place in places:
            path = str(Path(place) / options.resourceType / name) if place else name
            if path not in seen and Path(path).exists():
                seen.add(path)
                yield path
                if options.duplicateFilesPolicy == ResourceFinderOptions.First:
                    return

    def _places(self, options: ResourceFinderOptions) -> Iterator[str]:
        where, flavor, o = options.searchLocations, options.searchFlavor, ResourceFinderOptions
        if where & o.Directory:
            yield str(Path.cwd())
        if where & o.NearMainConfig and self._near_main and self._main_folder:
            yield self._main_folder
        if where & o.Robot:
            yield from self._existing("robots", self._directories.robot())
        if where & o.Context and not self._near_main:
            yield from self._context_folders()
        if where & o.User and flavor & o.ConfigLike:
            yield str(self._directories.config_home())
        if where & o.User and flavor & o.DataLike:
            yield str(self._directories.data_home())
        if where & o.Sysadmin:
            yield from map(str, self._directories.config_dirs())
        if where & o.Installed:
            yield from map(str, self._directories.data_dirs())
            yield from self._path_d()

    def _context_folders(self) -> Iterator[str]:
        for context in self._contexts:
            yield from self._existing("contexts", context)

    def _existing(self, kind: str, name: str) -> Iterator[str]:
        for place in self._places(ResourceFinderOptions(ResourceFinderOptions.Default)):
            path = Path(place) / kind / name
            if path.is_dir():
                yield str(path)

    def _path_d(self) -> Iterator[str]:
        """Folders that packages added by files ``config/path.d/*.ini``: ``[search NAME]`` with ``path /a /b``."""
        for folder in self._directories.data_dirs():
            for file in sorted((folder / "config" / "path.d").glob("*.ini")):
                found = Property()
                if found.fromConfigFile(str(file)):
                    yield from _search_paths(found)

    def _said_places(self) -> str:
        return ", ".join(self._places(ResourceFinderOptions()))


def _search_paths(found: Property) -> Iterator[str]:
    names = found.findGroup("search").tail()
    for i in range(names.size()):
        paths = found.findGroup(names.get(i).asString()).findGroup("path").tail()
        for k in range(paths.size()):
            yield paths.get(k).asString()


def _is_windows_absolute(name: str) -> bool:
    return name[:1] in ("/", "\\") or name[1:2] == ":"


def _strings(texts: Sequence[str] | Iterator[str]) -> Bottle:
    bottle = Bottle()
    for text in texts:
        bottle.addString(text)
    return bottle


def _from_text(text: str) -> Value:
    value = Value()
    value.fromString(text)
    return value
