"""Finds the definitions of ROS message types and makes one class for each.

A library searches added definitions (``add``), folders (``folders``, then ``YARP_ROSMSG_PATH``), installed packages of
ROS 1 and ROS 2 (``ROS_PACKAGE_PATH``, ``AMENT_PREFIX_PATH``, ``CMAKE_PREFIX_PATH``), a Midspan daemon on the YARP
network (``ask``), and finally two built-in definitions, ``std_msgs/Header`` and ``std_msgs/String``.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from yarp_compat.rosmsg.definition import MAX_TEXT, DefinitionError, MessageDefinition, full_name, parse
from yarp_compat.rosmsg.message import Message, make_class

MAX_DEPTH = 32  # the deepest nesting of messages

_NAME = re.compile(r"[A-Za-z]\w*/[A-Za-z]\w*")

# These need no file: every ROS has them, and nearly every message contains a header.
_KNOWN = {"std_msgs/Header": "uint32 seq\ntime stamp\nstring frame_id\n", "std_msgs/String": "string data\n"}


class MessageLibrary:
    """Message classes by type name.

    ``folders`` contain ``package/msg/Name.msg`` or ``package/Name.msg``, or are a package's folder; ``ask`` is called
    with a type's name if no file defines it, and returns its full definition, or None.
    """

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        self.folders: list[Path] = []
        self.ask: Callable[[str], str | None] | None = None
        self._environment = os.environ if environment is None else environment
        self._definitions: dict[str, MessageDefinition] = {}
        self._classes: dict[str, type[Message]] = {}
        self._lock = threading.RLock()

    def add(self, name: str, text: str) -> None:
        """Add a type's definition, optionally with its nested types appended; raises `DefinitionError`."""
        with self._lock:
            self._definitions |= parse(text, name)

    def get(self, name: str) -> type[Message]:
        """Return the class of a type, ``std_msgs/String`` or ``std_msgs/msg/String``; raises `DefinitionError`."""
        with self._lock:
            return self._class(full_name(name), ())

    def _class(self, name: str, path: tuple[str, ...]) -> type[Message]:
        if name in path or len(path) > MAX_DEPTH:
            raise DefinitionError(
                f"{path[0]} cannot be used: {name} contains itself, or messages nest more than {MAX_DEPTH} deep"
            )
        if name not in self._classes:
            definition = self._definition(name, path)
            needed = [field.type for field in definition.fields if field.is_message]
            nested = {type_name: self._class(type_name, (*path, name)) for type_name in needed}
            self._classes[name] = make_class(definition, nested)
        return self._classes[name]

    def _definition(self, name: str, path: tuple[str, ...]) -> MessageDefinition:
        if not _NAME.fullmatch(name):
            raise DefinitionError(f"{name!r} is not the name of a ROS message")
        if name not in self._definitions:
            text = self._find(name)
            if text is None:
                wanted = f", which {path[-1]} contains," if path else ""
                raise DefinitionError(
                    f"no definition of {name}{wanted} is known: add a folder with its .msg file to YARP_ROSMSG_PATH "
                    "or yarp.rosmsg.folders, install the package, or start a Midspan daemon on this YARP network"
                )
            self._definitions = parse(text, name) | self._definitions
        return self._definitions[name]

    def _find(self, name: str) -> str | None:
        package, _, base = name.partition("/")
        for folder in self._places():
            for path in (folder / package / "msg" / f"{base}.msg", folder / package / f"{base}.msg"):
                if path.is_file():
                    return _read(path, name)
            if folder.name == package and (folder / "msg" / f"{base}.msg").is_file():
                return _read(folder / "msg" / f"{base}.msg", name)
        text = self.ask(name) if self.ask is not None else None
        return text if text is not None else _KNOWN.get(name)

    def _places(self) -> Iterator[Path]:
        yield from self.folders
        yield from _paths(self._environment.get("YARP_ROSMSG_PATH", ""))
        yield from _paths(self._environment.get("ROS_PACKAGE_PATH", ""))
        for variable in ("AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"):
            yield from (path / "share" for path in _paths(self._environment.get(variable, "")))


def _paths(text: str) -> list[Path]:
    return [Path(part) for part in text.split(os.pathsep) if part]


def _read(path: Path, name: str) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_TEXT + 1)
        return data.decode()
    except (OSError, UnicodeDecodeError) as err:
        raise DefinitionError(f"cannot read the definition of {name} in {path}: {err}") from None


LIBRARY = MessageLibrary()  # of the program, used by ``yarp.rosmsg``
