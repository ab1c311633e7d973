"""Finds definitions on this machine. No file is read before it is needed.

A source returns a type's own definition, and those of nested types if the same file holds them.
Names are checked against ROS's grammar before they become paths. The standard types of Noetic and Jazzy and the IDL
parser come from rosbags.
"""

# ruff: noqa: D102 - `DefinitionSource` documents the methods

from __future__ import annotations

import ast
import os
import re
import site
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Protocol

from bridge.messages.definitions.hashes import EMPTY_MEMBER
from bridge.messages.definitions.names import ROS1_PACKAGES, is_legal_type, is_ros1_name, is_ros2_name, package_name
from bridge.messages.definitions.parts import (
    CONTENTS,
    actionlib_names,
    base_of,
    find_actionlib,
    find_part,
    read_sections,
    with_generated_parts,
)
from bridge.messages.definitions.schema import (
    PRIMITIVE_SIZES,
    STRING_TYPES,
    Constant,
    Definition,
    Field,
    FieldType,
    Shape,
    World,
)
from bridge.messages.definitions.stores import read_store
from bridge.messages.definitions.text import MAX_TEXT, parse_definition, parse_full, spell, split_parts
from bridge.messages.errors import MessageTypeError

Found = dict[str, Definition]

_OWN = Path(__file__).parent
_MAX_CACHED = 10_000

_FULL_TEXT = re.compile(r'^  _full_text = (r?"""(?:[^"\\]|\\.|"(?!""))*""")', re.MULTILINE | re.DOTALL)


class DefinitionSource(Protocol):
    """One place that holds definitions of one world."""

    def find(self, name: str) -> Found | None:
        """Return the definition of ``name``, then those of nested types in the same file; None if it is missing."""

    def names(self, package: str, kind: str = "msg") -> list[str]:
        """Return the names of the package's messages, services (``srv``) or (of ROS 2 only) actions in this place."""


class DefinitionFolder:
    """A folder of ``.msg``, ``.srv`` and ``.action`` (or ``.idl``) files.

    Files are laid out as ``<package>/msg/<Name>.msg`` (``srv`` and ``action`` likewise) or ``<package>/<Name>.msg``, or
    ``root`` is itself a package's folder or its ``msg``, ``srv`` or ``action``. A package is found by the name in its
    ``package.xml`` and by the name of its folder.
    """

    def __init__(self, root: Path, world: World) -> None:
        self.root = root
        self.world = world
        self._path = str(root)

    def folders(self, package: str, kind: str) -> Iterator[Path]:
        """Yield the folders of this tree that hold the package's files of one kind (``msg``, ``srv``, ``action``)."""
        return (Path(folder) for folder in self._candidates(package, kind) if os.path.isdir(folder))  # noqa: PTH112

    def _candidates(self, package: str, kind: str) -> Iterator[str]:
        """Yield possible paths of such folders, first those that are known without reading each ``package.xml``."""
        yield f"{self._path}/{package}/{kind}"  # text, because many lookups find nothing, and `Path` is slow
        if kind == "msg":
            yield f"{self._path}/{package}"
        for folder in self._renamed.get(package, ()):
            yield from (f"{folder}/{kind}", str(folder))
        if package in self._names:
            yield from (f"{self._path}/{kind}", self._path)
        if package in self._parent_names and kind in self._own_names:
            yield self._path

    @cached_property
    def _names(self) -> set[str]:
        """The names by which the root may be a package's folder: its own name, and that in its ``package.xml``."""
        return {self.root.name, package_name(self.root)}

    @cached_property
    def _own_names(self) -> set[str]:
        """The root's name, and the name of the folder that it links to."""
        return {self.root.name, self.root.resolve().name}

    @cached_property
    def _parent_names(self) -> set[str]:
        """The same names of the root's parent, for a root that is a package's ``msg``, ``srv`` or ``action``."""
        return {self.root.parent.name, package_name(self.root.resolve().parent)}

    @cached_property
    def _renamed(self) -> Mapping[str, list[Path]]:
        """Package folders in the root that are not named after their package, by the package's name."""
        folders: dict[str, list[Path]] = {}
        for file in sorted(self.root.glob("*/package.xml")):
            if (name := package_name(file.parent)) != file.parent.name:
                folders.setdefault(name, []).append(file.parent)
        return folders

    def find(self, name: str) -> Found | None:
        parts = name.split("/")
        package, kind, short = parts if len(parts) == 3 else (parts[0], "msg", parts[1])
        if self.world is World.ROS2 and kind == "msg" and not is_legal_type(name):
            return None
        for folder in self.folders(package, kind):
            if kind != "msg":
                definitions = self._part(folder, name)
                if definitions is not None:
                    return definitions
                continue
            if (path := folder / f"{short}.msg").is_file():
                return self._native({name: parse_definition(read_text(path), name, self.world)}, path)
            if self.world is World.ROS2 and (path := folder / f"{short}.idl").is_file():
                return parse_idl(read_text(path), name)
        if self.world is World.ROS1 and kind == "msg":
            for folder in self.folders(package, "action"):
                definitions = find_actionlib(folder, name)
                if definitions is not None:
                    stem = next(iter(definitions)).rpartition("/")[2].removesuffix("Goal")
                    return self._native(definitions, folder / f"{stem}.action")
        return None

    def _part(self, folder: Path, name: str) -> Found | None:
        definitions = find_part(folder, name, self.world)
        stem = base_of(name, self.world).rpartition("/")[2]
        if definitions is not None:
            return self._native(definitions, folder / f"{stem}.{name.split('/')[1]}")
        path = folder / f"{stem}.idl"
        if self.world is World.ROS2 and path.is_file():
            return with_generated_parts(parse_idl(read_text(path), _first_part(name)), name, self.world)
        return None

    def _native(self, found: Found, path: Path) -> Found | None:
        """Return a file's definitions; None if the file is written for the other world.

        The types of such a file are derived from those of the other world. Raises `MessageTypeError` if the file is
        written for neither world.
        """
        if all(map(_is_native, found.values())):
            return found
        other = World.ROS1 if self.world is World.ROS2 else World.ROS2
        if all(_is_native(parse_definition(part, "any/msg/Any", other)) for part in split_parts(read_text(path))):
            return None
        raise MessageTypeError(
            f"{path} mixes syntax of ROS 1 only with syntax of ROS 2 only",
            "if the file has bounds, default values or types of ROS 2, write std_msgs/Header, builtin_interfaces/Time"
            " and builtin_interfaces/Duration instead of Header, time and duration",
        )

    def files(self, package: str) -> dict[str, str]:
        """Return the text of the package's definition files by their path within the package."""
        texts: dict[str, str] = {}
        for kind in ("msg", "srv", "action"):
            for folder in self.folders(package, kind):
                for path in sorted(folder.glob(f"*.{kind}")):
                    name = f"{package}/{kind}/{path.stem}"
                    if self.find(name if kind == "msg" else _first_part(name)) is not None:
                        text = read_text(path) if kind == "msg" else "---\n".join(read_sections(path, kind))
                        texts.setdefault(f"{kind}/{path.name}", text)
        return texts

    def names(self, package: str, kind: str = "msg") -> list[str]:
        middle = "" if self.world is World.ROS1 and kind == "msg" else f"{kind}/"
        stems = self._stems(package, kind)
        if self.world is World.ROS1 and kind == "msg":
            stems |= set(actionlib_names(self._stems(package, "action")))
        if self.world is World.ROS2:
            stems = {stem for stem in stems if is_legal_type(f"{package}/{kind}/{stem}")}
        return [f"{package}/{middle}{stem}" for stem in sorted(stems)]

    def _stems(self, package: str, kind: str) -> set[str]:
        suffixes = (f".{kind}", ".idl")
        return {p.stem for f in self.folders(package, kind) for p in f.iterdir() if p.suffix in suffixes}


class GenpyPackages:
    """ROS 1 Python packages, read as text because a process cannot import both these and ROS 2's of the same names."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def find(self, name: str) -> Found | None:
        if name.count("/") > 1:
            return self._service(name)
        package, short = name.split("/")
        texts = self._texts(self.root / package / "msg" / f"_{short}.py")
        return parse_full(texts[0], name, World.ROS1) if texts else None

    def names(self, package: str, kind: str = "msg") -> list[str]:
        middle = "" if kind == "msg" else f"{kind}/"
        files = (self.root / package / kind).glob("_[A-Za-z]*.py")
        return [f"{package}/{middle}{path.stem[1:]}" for path in sorted(files)]

    def _service(self, name: str) -> Found | None:
        """Return the request or response of a service: one file holds both texts, in this order."""
        package, kind, short = name.split("/")
        base, _, part = short.rpartition("_")
        texts = self._texts(self.root / package / "srv" / f"_{base}.py") if kind == "srv" else []
        if part not in CONTENTS["srv"] or len(texts) != len(CONTENTS["srv"]):
            return None
        return parse_full(texts[CONTENTS["srv"].index(part)], name, World.ROS1)

    def _texts(self, path: Path) -> list[str]:
        """Return the full definitions in a generated file."""
        if not path.is_file():
            return []
        return [str(ast.literal_eval(text)) for text in _FULL_TEXT.findall(read_text(path))]


class RosbagsTypes:
    """The standard types that rosbags ships."""

    def __init__(self, world: World) -> None:
        self.world = world

    def find(self, name: str) -> Found | None:
        definition = find_in_store(name, self.world)
        return None if definition is None else {name: definition}

    def names(self, package: str, kind: str = "msg") -> list[str]:
        return store_names(package, self.world) if kind == "msg" else []


class ShippedTypes:
    """A source that Midspan ships. It does not change while Midspan runs, so each type is read and parsed only once.

    The versions of a type in the releases, and all types that nest it, share the result. Safe to use from any thread.
    """

    def __init__(self, source: DefinitionSource) -> None:
        self._source = source
        self._found: dict[str, Found | None] = {}

    def find(self, name: str) -> Found | None:
        try:
            return self._found[name]
        except KeyError:
            found = self._source.find(name)
        if len(self._found) >= _MAX_CACHED:
            self._found.clear()
        self._found[name] = found
        return found

    def names(self, package: str, kind: str = "msg") -> list[str]:
        return self._source.names(package, kind)


def find_first(sources: Iterable[DefinitionSource], name: str, world: World) -> Found | None:
    """Return the definitions from the first source that has ``name``; None if none has it, or the name is invalid."""
    # requests and responses of ROS 1 services have names in the form of ROS 2 (pkg/srv/Name_Request)
    if not is_ros2_name(name) and (world is World.ROS2 or not is_ros1_name(name)):
        return None
    for source in sources:
        definitions = source.find(name)
        if definitions is not None:
            return definitions
    return None


def ros1_sources(folders: Sequence[Path], packages: Path | None) -> list[DefinitionSource]:
    """Return the sources of ROS 1 definitions, the most specific first."""
    python = [packages] if packages is not None else _ros1_python_folders()
    shares = [*_split(os.environ.get("ROS_PACKAGE_PATH")), Path("/opt/ros/noetic/share"), Path("/usr/share")]
    return [
        *(DefinitionFolder(folder, World.ROS1) for folder in folders),
        *(GenpyPackages(folder) for folder in python if folder.is_dir()),
        *(DefinitionFolder(folder, World.ROS1) for folder in shares if folder.is_dir()),
        *_noetic_sources(),
    ]


def ros2_sources(folders: Sequence[Path], prefixes: Sequence[Path]) -> list[DefinitionSource]:
    """Return the sources of ROS 2 definitions, the most specific first."""
    roots = [*prefixes, *_split(os.environ.get("AMENT_PREFIX_PATH")), Path(sys.prefix), Path("/opt/ros/jazzy")]
    shares = dict.fromkeys(root / "share" for root in roots)
    return [
        *(DefinitionFolder(folder, World.ROS2) for folder in folders),
        *(DefinitionFolder(share, World.ROS2) for share in shares if share.is_dir()),
        *jazzy_sources(),
    ]


@cache
def jazzy_sources() -> tuple[DefinitionSource, ...]:
    """Return the sources of the Jazzy definitions that Midspan and rosbags ship."""
    bundled = Path(__file__).parents[2] / "interfaces" / "definitions"
    folders = [shipped_folder(folder) for folder in (bundled, _OWN / "ros2")]
    return *folders, ShippedTypes(RosbagsTypes(World.ROS2))


@cache
def _noetic_sources() -> tuple[DefinitionSource, ...]:
    return shipped_folder(_OWN / "ros1", World.ROS1), ShippedTypes(RosbagsTypes(World.ROS1))


@cache
def shipped_folder(folder: Path, world: World = World.ROS2) -> ShippedTypes:
    """Return the source for a folder of definitions that Midspan ships."""
    return ShippedTypes(DefinitionFolder(folder, world))


def _is_native(definition: Definition) -> bool:
    """Whether the definition was written in the syntax of its world; see `parse_definition`."""
    return bool(definition.text or not (definition.fields or definition.constants))


def _first_part(name: str) -> str:
    """Return the name of the first part of a service or action."""
    return f"{base_of(name, World.ROS2)}_{CONTENTS[name.split('/')[1]][0]}"


def read_text(path: Path) -> str:
    """Return a definition file's text; raises `MessageTypeError` if it cannot be read."""
    try:
        if path.stat().st_size > MAX_TEXT:
            raise MessageTypeError(f"{path} is larger than {MAX_TEXT} bytes")
        return path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as err:
        raise MessageTypeError(f"cannot read {path}: {err}") from None


def _ros1_python_folders() -> list[Path]:
    """Return Debian's, the sourced workspaces' and /opt/ros's folders of ROS 1 Python packages; not the venv's own."""
    site_folders = {Path(folder).resolve() for folder in site.getsitepackages()}
    wanted = [*_split(os.environ.get(ROS1_PACKAGES)), *_split(os.environ.get("PYTHONPATH"))]
    wanted += [Path("/opt/ros/noetic/lib/python3/dist-packages"), Path("/usr/lib/python3/dist-packages")]
    return [folder for folder in dict.fromkeys(wanted) if folder.resolve() not in site_folders]


def _split(paths: str | None) -> list[Path]:
    return [Path(path) for path in (paths or "").split(os.pathsep) if path]


_STORES = {World.ROS1: "ros1_noetic", World.ROS2: "ros2_jazzy"}
_TIMES = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}
_IDL_BASES = {"octet": "byte", "boolean": "bool"}
_IDL_SPELLED = {"float128": "long double"}  # in rosbags, and in IDL
_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4  # rosbags.interfaces.Nodetype


def find_in_store(name: str, world: World) -> Definition | None:
    """Return the definition of a standard type; None if rosbags lacks it, and for ROS 1's primitive ``time`` types."""
    store = _store(world)
    key = name if world is World.ROS2 else name.replace("/", "/msg/", 1)
    if world is World.ROS1 and key in _TIMES:
        return None
    return _definition(key, store[key], world) if key in store else None


def store_names(package: str, world: World) -> list[str]:
    """Return the names of the types of a package in the store."""
    names = [key for key in _store(world) if key.startswith(f"{package}/")]
    return names if world is World.ROS2 else [key.replace("/msg/", "/", 1) for key in names]


def parse_idl(text: str, name: str) -> dict[str, Definition]:
    """Return an ``.idl`` file's messages, or a service's request and response.

    Raises `MessageTypeError` if the file cannot be read or does not define ``name``.
    """
    from rosbags.typesys import TypesysError, get_types_from_idl  # slow, and seldom needed

    try:
        types = get_types_from_idl(text)
    except TypesysError as err:
        raise MessageTypeError(f"cannot read the IDL definition of {name}: {err}") from None
    definitions = {key: _definition(key, value, World.ROS2) for key, value in types.items()}
    if name not in definitions:
        raise MessageTypeError(f"the IDL file of {name} defines {', '.join(definitions) or 'nothing'} instead")
    return definitions


@cache
def _store(world: World) -> Mapping[str, Any]:
    return read_store(_STORES[world])


def _definition(key: str, value: Any, world: World) -> Definition:
    constants, fields = value
    name = key if world is World.ROS2 else key.replace("/msg/", "/", 1)
    return Definition(
        name,
        world,
        tuple(Field(f, _type(desc, name, world)) for f, desc in fields if f != EMPTY_MEMBER),
        tuple(Constant(c, _IDL_BASES.get(base, base), str(v)) for c, base, v in constants),
    )


def _type(desc: Any, owner: str, world: World) -> FieldType:
    kind, content = int(desc[0]), desc[1]
    if kind in (_ARRAY, _SEQUENCE):
        inner = _type(content[0], owner, world)
        shape = Shape.ARRAY if kind == _ARRAY else Shape.SEQUENCE
        return FieldType(inner.base, shape, content[1], inner.string_bound)
    if kind == _NAME:
        if world is World.ROS1 and content in _TIMES:
            return FieldType(_TIMES[content])
        return FieldType(spell(content, owner, world))
    base, bound = _IDL_BASES.get(content[0], content[0]), content[1]
    if base not in PRIMITIVE_SIZES and base not in STRING_TYPES:
        raise MessageTypeError(
            f"{owner} has a field with the IDL type {_IDL_SPELLED.get(base, base)}, which Midspan cannot convert",
            "leave the field out, or give it a type that .msg files have, too",
        )
    return FieldType(base, string_bound=bound)
