"""``ResourceFinder``: finds a program's configuration and data files, and reads its command line."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from yarp_compat.os.data.bottle import Bottle, Property, Searchable, Value
from yarp_compat.os.resource_places import ResourceFinderOptions, ResourceSearch
from yarp_compat.overriding import override
from yarp_compat.wire.accessors import getter

log = logging.getLogger("yarp.os.ResourceFinder")


class ResourceFinder(Searchable):
    """A search for files by name in YARP's folders, with the program's configuration.

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
        """Return the program's shared finder."""
        if cls._singleton is None:
            cls._singleton = cls()
        return cls._singleton

    def configure(self, *args: Any) -> bool:
        """Read a command line: ``configure(sys.argv)``, without its first word unless the second argument is False.

        The older forms ``configure(argc, argv)`` and ``configure(policy, argv)`` work too. Returns False if the file
        given by ``--from`` cannot be read.
        """
        argv, skip = self._command_line(args)
        self._configured = True
        given = Property()
        given.fromCommand(argv, skip)
        if given.check("context"):
            self._search.contexts = [given.find("context").asString()]
        self._property.fromCommand(argv, skip, False)
        if not self._property.check("from"):
            return True
        name = self._property.find("from").toString().strip('"')
        path = self._search.find_main(name)
        read = self._property.fromConfigFile(path or name, False)
        if not read:
            log.warning("cannot read the configuration file %s (searched in %s)", name, self._search.place_names())
        self._property.fromCommand(argv, skip, False)  # the command line has priority over the file
        return bool(read) or not given.check("from")

    @staticmethod
    def _command_line(args: tuple[Any, ...]) -> tuple[list[str], bool]:
        arguments = [
            arg for arg in args if not isinstance(arg, str) and (isinstance(arg, bool) or not isinstance(arg, int))
        ]
        if not arguments or isinstance(arguments[0], bool):
            raise TypeError("ResourceFinder.configure expects a list of words, as in configure(sys.argv)")
        return [str(argument) for argument in arguments[0]], bool(arguments[1]) if len(arguments) > 1 else True

    isConfigured = getter("_configured", bool, "Whether `configure` was called.")

    def setDefaultContext(self, context: str) -> bool:
        """Set the context to search in, unless the command line names another."""
        self._search.contexts = [context] if context else []
        return True

    def setDefaultConfigFile(self, name: str) -> bool:
        """Set the configuration file to read, unless the command line names another."""
        return self.setDefault("from", name)

    def setDefault(self, key: str, value: Any) -> bool:
        """Set the default of a key, for when the command line and the configuration file lack it."""
        if not self._property.check(key):
            self._property.put(key, Value.makeValue(value) if isinstance(value, str) else value)
        return True

    def setVerbose(self, verbose: bool = True) -> bool:
        """Log each file that is not found, with the searched folders."""
        log.setLevel(logging.DEBUG if verbose else logging.INFO)
        return True

    def setQuiet(self, quiet: bool = True) -> bool:
        """Log only warnings."""
        log.setLevel(logging.WARNING if quiet else logging.INFO)
        return True

    @override
    def find(self, key: str) -> Value:
        return self._property.find(key)

    @override
    def findGroup(self, key: str) -> Bottle:
        return self._property.findGroup(key)

    def findNestedResourceFinder(self, key: str) -> ResourceFinder:
        """Return a finder for a group's keys, with the same folders."""
        nested = ResourceFinder(self)
        group = self.findGroup(key)
        nested._property = Property()
        nested._property.fromString(group.toString())
        nested._null = group.isNull()
        nested._configured = True
        return nested

    isNull = getter("_null", bool, "Whether this is the finder for a missing group.")

    @override
    def toString(self) -> str:
        return self._property.toString()

    def getContext(self) -> str:
        """Return the context to search in, or ""."""
        return self._search.contexts[0] if self._search.contexts else ""

    def getContexts(self) -> Bottle:
        """Return the contexts to search in."""
        return Bottle(self._search.contexts)

    def findFile(self, name: str, options: ResourceFinderOptions | None = None) -> str:
        """Return the path of a file, or of the file that the key ``name`` gives; "" if not found."""
        return self.findFileByName(self._value_or_name(name), options)

    def findFileByName(self, name: str, options: ResourceFinderOptions | None = None) -> str:
        """Return the path of the file with exactly this name; "" if not found."""
        path = self._search.first(name, options or ResourceFinderOptions())
        if not path:
            log.debug("%s not found in %s", name, self._search.place_names())
        return path

    def findPath(self, name: str = "", options: ResourceFinderOptions | None = None) -> str:
        """Return the path of a folder; without a name, the first folder to search in."""
        chosen = options or ResourceFinderOptions()
        return self._search.first(self._value_or_name(name) if name else "", chosen, folder=True) or (
            "" if name else str(Path.cwd())
        )

    def findPaths(self, name: str, options: ResourceFinderOptions | None = None) -> Bottle:
        """Return the paths of all folders and files with this name."""
        every = options or ResourceFinderOptions.findAllMatch()
        return Bottle(list(self._search.paths(self._value_or_name(name), every, folder=True)))

    def getContextPath(self) -> str:
        """Return the first folder of the context that exists, or ""."""
        return next(iter(self._search.context_folders()), "")

    def getHomeContextPath(self) -> str:
        """Return the user's folder for the context's files; create it if missing.

        If the main configuration file is in the current directory, return that file's folder.
        """
        return self._home("contexts", self.getContext())

    def getHomeRobotPath(self) -> str:
        """Return the user's folder for the robot's files, like `getHomeContextPath`."""
        return self._home("robots", self._search.directories.robot())

    def readConfig(self, config: Property, key: str, options: ResourceFinderOptions) -> bool:
        """Read the files with a name that the options select into ``config``; files found earlier have priority."""
        paths = list(self._search.paths(self._value_or_name(key), options, folder=True))
        for path in reversed(paths):
            config.fromConfigFile(path, False)
        return bool(paths)

    def _value_or_name(self, name: str) -> str:
        return self._property.find(name).asString() if self._property.check(name) else name

    def _home(self, kind: str, name: str) -> str:
        if self._search.near_main:
            return self._search.main_folder
        path = self._search.home_of(kind, name)
        try:
            Path(path).mkdir(parents=True, exist_ok=True)
        except OSError as err:
            log.warning("cannot create the folder %s: %s", path, err)
        return path
