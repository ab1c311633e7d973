"""Interface definition texts (.msg, .srv, .action): what they need, and whether ROS 2 would take them.

The generators of ROS 2 fail late and without a line number, and trip over comments; so each text is checked here first,
and handed on without comments. The rules are those of ROS 2 Jazzy's interface language (docs.ros.org, "Interfaces");
the patterns of names are those that `rosidl_adapter` 4.6 applies. Texts come from folders of message packages, and from
those that Midspan brings itself (bundled packages).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from pathlib import Path


class BuildError(Exception):
    """A message package cannot be built; ``where`` is ``package/msg/Name.msg:line``, ``cure`` what a person can do."""

    def __init__(self, message: str, where: str = "", cure: str = "") -> None:
        text = f"{where}: {message}" if where else message
        super().__init__(f"{text}. {cure}" if cure else text)
        self.where = where
        self.cure = cure


PRIMITIVES = frozenset(
    {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
ROS1_TYPES = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}

_PACKAGE = re.compile(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*")
_TYPE = re.compile(r"[A-Z][A-Za-z0-9]*")
_CONSTANT = re.compile(r"[A-Z](?:_?[A-Z0-9])*")
_VALUE = re.compile(r"[ -\[\]-~]*")  # printable ASCII but the backslash: rosidl garbles the rest on the way to C
_FIELD_TYPE = re.compile(r"(?P<base>[A-Za-z0-9_/]+)(?P<bound><=[1-9]\d*)?(?P<array>\[(?:(?:<=)?[1-9]\d*)?\])?")


MAX_TEXT = 1_000_000
"""Characters that a package's definitions may have: they may come from the network, and are compiled."""


class Form(Enum):
    """The kinds of interface file: the folder's name, and how many parts ``---`` cuts the file into."""

    MSG = "msg"
    SRV = "srv"
    ACTION = "action"

    @property
    def parts(self) -> int:
        """How many field lists a file of this kind has."""
        return {Form.MSG: 1, Form.SRV: 2, Form.ACTION: 3}[self]


IMPLICIT = {
    Form.MSG: frozenset[str](),
    Form.SRV: frozenset({"builtin_interfaces", "service_msgs"}),
    Form.ACTION: frozenset({"action_msgs", "builtin_interfaces", "service_msgs", "unique_identifier_msgs"}),
}
"""Packages that what the generators add to a service or an action refers to."""


@dataclass(frozen=True, slots=True)
class Reference:
    """A message type that a definition's field names, and the line (from 1) where it does."""

    package: str
    name: str
    line: int


@dataclass(frozen=True, slots=True)
class InterfaceFile:
    """One checked definition; ``bare`` is its text without comments and with full names of types."""

    package: str
    path: str
    form: Form
    text: str
    bare: str
    references: tuple[Reference, ...]

    @property
    def needs(self) -> frozenset[str]:
        """Names of the packages, other than its own, that the definition needs directly."""
        named = {reference.package for reference in self.references}
        return frozenset(named | IMPLICIT[self.form]) - {self.package}

    def where(self, line: int) -> str:
        """Place of a line, for an error."""
        return f"{self.package}/{self.path}:{line}"


def read_package(package: str, files: Mapping[str, str]) -> tuple[InterfaceFile, ...]:
    """Check a package's definitions one by one, in the order of their paths; raises `BuildError`."""
    if not _PACKAGE.fullmatch(package):
        raise BuildError(f"'{package}' is not a ROS 2 package name", cure="Use small letters, digits and underscores")
    if not files:
        raise BuildError(f"package {package} has no definitions", cure="Give at least one msg/Name.msg")
    if sum(map(len, files.values())) > MAX_TEXT:
        raise BuildError(f"package {package} has more than {MAX_TEXT} characters of definitions", cure="Split it")
    return tuple(_read(package, path, text) for path, text in sorted(files.items()))


def _read(package: str, path: str, text: str) -> InterfaceFile:
    folder, _, name = path.partition("/")
    stem, _, suffix = name.partition(".")
    forms = {form.value: form for form in Form}
    if folder != suffix or folder not in forms or not _TYPE.fullmatch(stem):
        raise BuildError(
            f"'{package}/{path}' is not the path of an interface definition",
            cure="It must read msg/Name.msg, srv/Name.srv or action/Name.action, Name in CamelCase",
        )
    reader = _Reader(package, path)
    bare = [reader.line(number, line) for number, line in _lines(text)]
    form = forms[folder]
    if bare.count("---") != form.parts - 1:
        raise BuildError(
            f"{bare.count('---')} lines '---' where a .{suffix} has {form.parts - 1}", where=f"{package}/{path}"
        )
    return InterfaceFile(package, path, form, text, "".join(f"{line}\n" for line in bare), tuple(reader.references))


def _lines(text: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(text.splitlines(), start=1):
        content = " ".join(line.split("#", 1)[0].split())
        if content:
            yield number, content


class _Reader:
    """Reads the lines of one definition; remembers the names of the part it is in."""

    def __init__(self, package: str, path: str) -> None:
        self.package = package
        self.path = path
        self.references: list[Reference] = []
        self._names: set[str] = set()
        self._part = 1

    def line(self, number: int, content: str) -> str:
        """Check one line without comment; returns it as the generators want it."""
        if content == "---":
            self._names.clear()
            self._part += 1
            return content
        field_type, _, rest = content.partition(" ")
        if not rest:
            raise self._fault(number, f"'{content}' is neither 'type name' nor 'TYPE NAME=value'")
        name, value, is_constant = _split(rest)
        self._check_name(number, name, is_constant=is_constant)
        if not _VALUE.fullmatch(value):
            raise self._fault(number, "the value has a backslash, or a character that is not plain ASCII")
        spelt = self._check_type(number, field_type, is_constant=is_constant)
        if is_constant:
            # rosidl's parser takes equal constants of two parts for one, unless their comments differ
            return f"{spelt} {name}={value}  # part {self._part}"
        return f"{spelt} {name} {value}" if value else f"{spelt} {name}"

    def _check_name(self, number: int, name: str, *, is_constant: bool) -> None:
        if is_constant and not _CONSTANT.fullmatch(name):
            raise self._fault(number, f"'{name}' is not a constant's name", "Use capitals, digits and underscores")
        if not is_constant and not _PACKAGE.fullmatch(name):
            raise self._fault(
                number, f"'{name}' is not a field's name in ROS 2", "Use small letters, digits and underscores"
            )
        if name in self._names:
            raise self._fault(number, f"'{name}' is there twice")
        self._names.add(name)

    def _check_type(self, number: int, field_type: str, *, is_constant: bool) -> str:
        match = _FIELD_TYPE.fullmatch(field_type)
        if match is None:
            raise self._fault(number, f"'{field_type}' is not a type")
        base, bound, array = match["base"], match["bound"] or "", match["array"] or ""
        if bound and base not in ("string", "wstring"):
            raise self._fault(number, f"'{field_type}': only strings have a bound of their own")
        if is_constant and (base not in PRIMITIVES or bound or array):
            raise self._fault(number, f"a constant cannot be of type '{field_type}'", "Use one of the plain types")
        if base not in PRIMITIVES:
            base = self._refer(number, base)
        return f"{base}{bound}{array}"

    def _refer(self, number: int, base: str) -> str:
        if base in ROS1_TYPES:
            raise self._fault(number, f"'{base}' is ROS 1's", f"ROS 2 calls it {ROS1_TYPES[base]}")
        parts = base.split("/")
        if len(parts) == 3 and parts[1] == "msg":
            del parts[1]
        package, name = parts if len(parts) == 2 else (self.package, base)
        if not _PACKAGE.fullmatch(package) or not _TYPE.fullmatch(name):
            raise self._fault(number, f"unknown type '{base}'", "Types are plain (float64, string ...) or package/Name")
        self.references.append(Reference(package, name, number))
        return f"{package}/{name}"

    def _fault(self, number: int, message: str, cure: str = "") -> BuildError:
        return BuildError(message, where=f"{self.package}/{self.path}:{number}", cure=cure)


def _split(rest: str) -> tuple[str, str, bool]:
    """Cut what follows the type into name, value, and whether it is a constant rather than a default."""
    name, equals, value = rest.partition("=")
    if equals and " " not in name.strip():
        return name.strip(), value.strip(), True
    name, _, value = rest.partition(" ")
    return name, value, False


def read_package_folder(folder: Path) -> dict[str, str]:
    """Definitions of a package's folder, text by path (``msg/Name.msg``); ``.msg`` files may lie in it directly."""
    files = {f"{form.value}/{file.name}": file for form in Form for file in folder.glob(f"{form.value}/*.{form.value}")}
    files |= {f"msg/{file.name}": file for file in folder.glob("*.msg")}
    return {path: _text(file) for path, file in sorted(files.items())}


def read_folders(folders: Iterable[Path]) -> dict[str, dict[str, str]]:
    """Definitions by package and path; each folder is a package's, or holds such. `BuildError` for none, or two."""
    found: dict[str, dict[str, str]] = {}
    for folder in folders:
        whole = folder.resolve()
        candidates = [whole, *sorted(entry for entry in whole.iterdir() if entry.is_dir())] if whole.is_dir() else []
        packages = {entry.name: files for entry in candidates if (files := read_package_folder(entry))}
        if not packages:
            raise BuildError(
                f"no .msg, .srv or .action files in {folder}",
                cure="Name a package's folder (my_msgs with my_msgs/msg/Name.msg), or one that holds such folders",
            )
        for package, files in packages.items():
            if package in found:
                raise BuildError(f"package {package} is there twice", cure="Leave out one of these folders")
            found[package] = files
    return found


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as err:
        raise BuildError(f"cannot be read: {err}", where=str(file)) from None


DEFINITIONS = Path(__file__).parent / "definitions"
"""Folder with their definitions; its README says where the field lists come from."""


@cache
def bundled_packages() -> tuple[str, ...]:
    """Names of the packages whose definitions come with Midspan."""
    return tuple(sorted(entry.name for entry in DEFINITIONS.iterdir() if entry.is_dir()))


def bundled_files(package: str) -> dict[str, str]:
    """A bundled package's definitions by path, as `bridge.interfaces.builder.build` takes them; {} for any other."""
    return read_package_folder(DEFINITIONS / package) if package in bundled_packages() else {}
