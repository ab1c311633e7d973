"""``ResourceFinder``: finds a program's configuration and data files, and reads its command line."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from yarp_compat.os.data.bottle import Bottle, Property, Searchable, Value
from yarp_compat.os.resource_places import ResourceFinderOptions, ResourceSearch
from yarp_compat.wire.accessors import getter

log = logging.getLogger("yarp.os.ResourceFinder")


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
        self._search = ResourceSearch()
        self._property = Property()
        self._configured = False
        self._null = False
        if other is not None:
            self._property.fromString(other._property.toString())
            self._search = other._search.copy()
            self._configured, self._null = other._configured, other._null

    @classmethod
    def getResourceFinderSingleton(cls) -> ResourceFinder:
        """The one of the program."""
        if cls._singleton is None:
            cls._singleton = cls()
        return cls._singleton

    def configure(self, *args: Any) -> bool:
        """Read a command line: ``configure(sys.argv)``, its first word skipped unless a second argument says False.

        The older forms ``configure(argc, argv)`` and ``configure(policy, argv)`` work too. Returns False where a file
        given by ``--from`` cannot be read.
        """
        words, skip = self._command_line(args)
        self._configured = True
        given = Property()
        given.fromCommand(words, skip)
        if given.check("context"):
            self._search.contexts = [given.find("context").asString()]
        self._property.fromCommand(words, skip, False)
        if not self._property.check("from"):
            return True
        name = self._property.find("from").toString().strip('"')
        found = self._search.find_main(name)
        read = self._property.fromConfigFile(found or name, False)
        if not read:
            log.warning("the configuration file %s cannot be read (looked for in %s)", name, self._search.said_places())
        self._property.fromCommand(words, skip, False)  # the command line outranks the file
        return bool(read) or not given.check("from")

    @staticmethod
    def _command_line(args: tuple[Any, ...]) -> tuple[list[str], bool]:
        rest = [arg for arg in args if not isinstance(arg, str) and (isinstance(arg, bool) or not isinstance(arg, int))]
        if not rest or isinstance(rest[0], bool):
            raise TypeError("ResourceFinder.configure takes a list of words, as in configure(sys.argv)")
        return [str(word) for word in rest[0]], bool(rest[1]) if len(rest) > 1 else True

    isConfigured = getter("_configured", bool, "Whether `configure` was called.")

    def setDefaultContext(self, context: str) -> bool:
        """The context to look in unless the command line says another."""
        self._search.contexts = [context] if context else []
        return True

    def setDefaultConfigFile(self, name: str) -> bool:
        """The configuration file to read unless the command line says another."""
        return self.setDefault("from", name)

    def setDefault(self, key: str, value: Any) -> bool:
        """A value to use unless the command line or the configuration file says another."""
        if not self._property.check(key):
            self._property.put(key, Value.makeValue(value) if isinstance(value, str) else value)
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
        """The value of a key; a null value where the key is missing."""
        return self._property.find(key)

    def findGroup(self, key: str) -> Bottle:
        """The group of a key; a null Bottle where the key is missing."""
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

    isNull = getter("_null", bool, "Whether this is the finder over a group that does not exist.")

    def toString(self) -> str:
        """All keys as a Bottle's text."""
        return self._property.toString()

    def getContext(self) -> str:
        """The context that is looked in, or empty."""
        return self._search.contexts[0] if self._search.contexts else ""

    def getContexts(self) -> Bottle:
        """The contexts that are looked in."""
        return Bottle(self._search.contexts)

    def findFile(self, name: str, options: ResourceFinderOptions | None = None) -> str:
        """The path of a file, or of the file that the key ``name`` gives; empty when it is not found."""
        return self.findFileByName(self._meant(name), options)

    def findFileByName(self, name: str, options: ResourceFinderOptions | None = None) -> str:
        """The path of the file of this very name; empty when it is not found."""
        found = self._search.first(name, options or ResourceFinderOptions())
        if not found:
            log.debug("%s is not found in %s", name, self._search.said_places())
        return found

    def findPath(self, name: str = "", options: ResourceFinderOptions | None = None) -> str:
        """The path of a folder; without a name, the first place that is looked in."""
        where = options or ResourceFinderOptions()
        return self._search.first(self._meant(name) if name else "", where, folder=True) or (
            "" if name else str(Path.cwd())
        )

    def findPaths(self, name: str, options: ResourceFinderOptions | None = None) -> Bottle:
        """The paths of all folders or files of this name."""
        every = options or ResourceFinderOptions.findAllMatch()
        return Bottle(list(self._search.paths(self._meant(name), every, folder=True)))

    def getContextPath(self) -> str:
        """The folder of the context: the first that is found, or empty."""
        return next(iter(self._search.context_folders()), "")

    def getHomeContextPath(self) -> str:
        """The folder for the context's files that the user changed; made when it is not there."""
        return self._home("contexts", self.getContext())

    def getHomeRobotPath(self) -> str:
        """The folder for the robot's files that the user changed; made when it is not there."""
        return self._home("robots", self._search.directories.robot())

    def readConfig(self, config: Property, key: str, options: ResourceFinderOptions) -> bool:
        """Read every file of a name into ``config``, those found first outranking the others."""
        paths = list(self._search.paths(self._meant(key), options, folder=True))
        for path in reversed(paths):
            config.fromConfigFile(path, False)
        return bool(paths)

    def _meant(self, name: str) -> str:
        return self._property.find(name).asString() if self._property.check(name) else name

    def _home(self, kind: str, name: str) -> str:
        if self._search.near_main:
            return self._search.main_folder
        path = self._search.home_of(kind, name)
        try:
            Path(path).mkdir(parents=True, exist_ok=True)
        except OSError as err:
            log.warning("the folder %s cannot be made: %s", path, err)
        return path
