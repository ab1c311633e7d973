"""Interface definition texts (.msg, .srv, .action): the packages that they need, and whether ROS 2 accepts them.

ROS 2's generators fail late and without a line number, and comments can break them. So each text is checked here first,
and passed to the generators without comments. The rules are those of ROS 2 Jazzy's interface language (docs.ros.org,
"Interfaces"); the patterns of names are those of `rosidl_adapter` 4.6.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum

from bridge.interfaces.values import string_value


class BuildError(Exception):
    """A message package cannot be built; ``where`` is ``package/msg/Name.msg:line``, and ``cure`` says what to do."""

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
_VALUE = re.compile(r"[ -\[\]-~]*")  # printable ASCII without the backslash
_FIELD_TYPE = re.compile(r"(?P<base>[A-Za-z0-9_/]+)(?P<bound><=[1-9]\d*)?(?P<array>\[(?:(?:<=)?[1-9]\d*)?\])?")


MAX_TEXT = 1_000_000
"""Maximum number of characters in a package's definitions, which may come from the network and are compiled."""


class Form(Enum):
    """The kinds of interface file, by the name of their folder."""

    MSG = "msg"
    SRV = "srv"
    ACTION = "action"

    @property
    def parts(self) -> int:
        """The number of field lists in a file of this kind."""
        return {Form.MSG: 1, Form.SRV: 2, Form.ACTION: 3}[self]


IMPLICIT = {
    Form.MSG: frozenset[str](),
    Form.SRV: frozenset({"builtin_interfaces", "service_msgs"}),
    Form.ACTION: frozenset({"action_msgs", "builtin_interfaces", "service_msgs", "unique_identifier_msgs"}),
}
"""Packages of the types of the fields that the generators add to services and actions."""


@dataclass(frozen=True, slots=True)
class Reference:
    """The message type of a field, and the field's line (from 1)."""

    package: str
    name: str
    line: int


@dataclass(frozen=True, slots=True)
class InterfaceFile:
    """One checked definition; ``bare`` is its text for the generators, without comments and with full type names."""

    package: str
    path: str
    form: Form
    text: str
    bare: str
    references: tuple[Reference, ...]

    @property
    def needs(self) -> frozenset[str]:
        """The names of the other packages that the definition needs directly."""
        named = {reference.package for reference in self.references}
        return frozenset(named | IMPLICIT[self.form]) - {self.package}

    def where(self, line: int) -> str:
        """Return the place of a line for an error."""
        return f"{self.package}/{self.path}:{line}"


def read_package(package: str, files: Mapping[str, str]) -> tuple[InterfaceFile, ...]:
    """Check a package's definitions one by one, in the order of their paths; raises `BuildError`."""
    if not _PACKAGE.fullmatch(package):
        raise BuildError(
            f"'{package}' is not a ROS 2 package name", cure="Use lower-case letters, digits and underscores"
        )
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
            cure="It must be msg/Name.msg, srv/Name.srv or action/Name.action, with Name in CamelCase",
        )
    reader = _Reader(package, path)
    bare = [reader.line(number, line) for number, line in _lines(text)]
    form = forms[folder]
    if bare.count("---") != form.parts - 1:
        raise BuildError(
            f"the number of lines '---' is {bare.count('---')}; a .{suffix} file must have {form.parts - 1}",
            where=f"{package}/{path}",
        )
    # programs of ROS 2 that read the installed text, such as `ros2 interface show`, accept no separator but '---'
    text = _SEPARATOR.sub("---", text)
    return InterfaceFile(package, path, form, text, "".join(f"{line}\n" for line in bare), tuple(reader.references))


_SEPARATOR = re.compile(r"^[ \t]*---[^\r\n]*", re.MULTILINE)


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines without comments; a separator is any line that begins with ``---``, as genmsg reads it."""
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.split("#", 1)[0].replace("\t", " ").strip()
        if content:
            yield number, "---" if content.startswith("---") else content


class _Reader:
    """Reads the lines of one definition, and collects the names of the current part."""

    def __init__(self, package: str, path: str) -> None:
        self.package = package
        self.path = path
        self.references: list[Reference] = []
        self._names: set[str] = set()
        self._part = 1

    def line(self, number: int, content: str) -> str:
        """Check one line without its comment; return it in the form that the generators need."""
        if content == "---":
            self._names.clear()
            self._part += 1
            return content
        field_type, _, value_text = content.partition(" ")
        if not value_text:
            raise self._fault(number, f"'{content}' is neither 'type name' nor 'TYPE NAME=value'")
        name, value, is_constant = _split(value_text)
        self._check_name(number, name, is_constant=is_constant)
        spelled = self._check_type(number, field_type, is_constant=is_constant)
        if value and re.split(r"[<[]", field_type)[0] in ("string", "wstring"):
            try:
                value = string_value(value, is_array="[" in field_type)
            except ValueError as err:
                raise self._fault(number, f"invalid string {value}: {err}") from None
        elif not _VALUE.fullmatch(value):
            raise self._fault(number, "the value has a backslash, or a character that is not plain ASCII")
        if is_constant:
            # rosidl's parser merges equal constants of two parts unless their comments differ
            return f"{spelled} {name}={value}  # part {self._part}"
        return f"{spelled} {name} {value}" if value else f"{spelled} {name}"

    def _check_name(self, number: int, name: str, *, is_constant: bool) -> None:
        if is_constant and not _CONSTANT.fullmatch(name):
            raise self._fault(number, f"'{name}' is not a constant's name", "Use capitals, digits and underscores")
        if not is_constant and not _PACKAGE.fullmatch(name):
            raise self._fault(
                number, f"'{name}' is not a field's name in ROS 2", "Use lower-case letters, digits and underscores"
            )
        if name in self._names:
            raise self._fault(number, f"the name '{name}' is used twice")
        self._names.add(name)

    def _check_type(self, number: int, field_type: str, *, is_constant: bool) -> str:
        match = _FIELD_TYPE.fullmatch(field_type)
        if match is None:
            raise self._fault(number, f"'{field_type}' is not a type")
        base, bound, array = match["base"], match["bound"] or "", match["array"] or ""
        if bound and base not in ("string", "wstring"):
            raise self._fault(number, f"'{field_type}': only strings and arrays can have a bound")
        if is_constant and (base not in PRIMITIVES or bound or array):
            raise self._fault(number, f"a constant cannot be of type '{field_type}'", "Use one of the plain types")
        if base not in PRIMITIVES:
            base = self._refer(number, base)
        return f"{base}{bound}{array}"

    def _refer(self, number: int, base: str) -> str:
        if base in ROS1_TYPES:
            raise self._fault(number, f"'{base}' is a type of ROS 1", f"In ROS 2 it is {ROS1_TYPES[base]}")
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


def _split(text: str) -> tuple[str, str, bool]:
    """Split the text after the type into name, value, and whether it is a constant rather than a default."""
    text = text.lstrip()
    name, equals, value = text.partition("=")
    if equals and " " not in name.strip():
        return name.strip(), value.strip(), True
    name, _, value = text.partition(" ")
    return name, value.strip(), False
