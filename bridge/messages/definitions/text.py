"""Reads and writes definitions as text: ``.msg``, ``.srv`` and ``.action`` of both worlds.

The grammar is that of genmsg (ROS 1, http://wiki.ros.org/msg) and of rosidl_adapter (ROS 2,
https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html). A text written for one world is also accepted for
the other: ``time``, ``duration`` and a bare ``Header`` for ROS 2, ``builtin_interfaces/Time`` and bounds for ROS 1.
Text is written in the form that ROS 1's connection headers and ROS 2's bags carry.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from bridge.messages.definitions.constants import constant_value, is_readable
from bridge.messages.definitions.hashes import EMPTY_MEMBER
from bridge.messages.definitions.names import is_legal_constant, is_legal_field, is_legal_type
from bridge.messages.definitions.schema import (
    PRIMITIVE_SIZES,
    STRING_TYPES,
    TIME_TYPES,
    Constant,
    DefaultValue,
    Definition,
    Field,
    FieldType,
    Schema,
    Shape,
    World,
)
from bridge.messages.errors import MessageTypeError

MAX_TEXT = 4 << 20  # longest definition text that is read, in characters
MAX_LINE = 20_000  # longest line that is read, in characters; comment lines may be longer
MAX_DEPTH = 64  # maximum nesting depth of types
MAX_ARRAY = 1 << 28  # longest fixed array or bound that is accepted
_SEPARATOR = re.compile(r"^={20,}[ \t]*\n", re.MULTILINE)
_LINE = re.compile(r"(\S+)\s+([A-Za-z_]\w*)\s*(.*)", re.DOTALL)
_BEFORE_VALUE = re.compile(r"\s*\S+\s+[A-Za-z_]")  # the type and the first letter of the name
_TYPE = re.compile(r"([A-Za-z][\w/]*)(?:<=(\d+))?(?:\[(?:(<=)?(\d+))?\])?(?P<empty>\[\])?")
_QUOTED = re.compile(r""""(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'""")
_FOREIGN_TO_ROS1 = re.compile(r"<=|wstring|builtin_interfaces/|/msg/")
_FOREIGN_TO_ROS2 = re.compile(r"(time|duration|Header)\b(?!/)")
_BUILTIN_TIMES = {"builtin_interfaces/Time": "time", "builtin_interfaces/Duration": "duration"}


def parse_definition(text: str, name: str, world: World) -> Definition:
    """Read one type's own definition; raises `MessageTypeError`, which names the type and, if one is wrong, the line.

    The result has an empty ``text`` if the definition is in the syntax of the other world.
    """
    if len(text) > MAX_TEXT:
        raise MessageTypeError(f"the definition of {name} is longer than {MAX_TEXT} characters")
    fields: list[Field] = []
    constants: list[Constant] = []
    native = True
    for number, line in enumerate(text.replace("\r\n", "\n").split("\n"), 1):
        bare = _strip_comment(line) if len(line) <= MAX_LINE else line.strip()
        if not bare or bare.startswith(("@", "#")):
            continue
        try:
            native &= _read_line(line, bare, name, world, fields, constants)
        except ValueError as err:
            msg = f"cannot read the definition of {name}, line {number} ({bare[:100]!r}): {err}"
            raise MessageTypeError(msg) from None
    seen: set[str] = set()
    for field in fields:
        if field.name in seen:
            raise MessageTypeError(f"the definition of {name} has two fields named {field.name!r}")
        seen.add(field.name)
    if world is World.ROS2 and seen == {EMPTY_MEMBER}:
        fields = []  # IDL's form of an empty message
    return Definition(name, world, tuple(fields), tuple(constants), text if native else "")


def parse_full(text: str, name: str, world: World) -> dict[str, Definition]:
    """Read a full definition: the type's own, then that of each nested type after lines of ``=`` and ``MSG: name``."""
    main, *sections = _SEPARATOR.split(text.replace("\r\n", "\n"))
    definitions = {name: parse_definition(main, name, world)}
    for part in sections:
        head, _, body = part.partition("\n")
        if not head.startswith("MSG:"):
            raise MessageTypeError(f"the full definition of {name} has a section without 'MSG: <type>' ({head[:60]!r})")
        nested = spell(head.removeprefix("MSG:").strip(), name, world)
        definitions.setdefault(nested, parse_definition(body, nested, world))
    return definitions


def split_parts(text: str) -> list[str]:
    """Return the parts of a ``.srv`` (request, response) or ``.action`` (goal, result, feedback) file.

    As in genmsg and genaction, every line that begins with ``---`` is a separator, including ``----`` and ``--- # x``.
    """
    parts: list[list[str]] = [[]]
    for line in text.replace("\r\n", "\n").split("\n"):
        if line.strip().startswith("---"):
            parts.append([])
        else:
            parts[-1].append(line)
    return ["\n".join(lines) + "\n" for lines in parts]


def spell(type_name: str, owner: str, world: World) -> str:
    """Return the full name, in the form of ``world``, of a type that the definition of ``owner`` mentions."""
    parts = type_name.split("/")
    if type_name in ("Header", "roslib/Header"):
        parts = ["std_msgs", "Header"]
    if len(parts) == 1:
        parts = [owner.split("/", 1)[0], parts[0]]
    if world is World.ROS2:
        return "/".join(parts if len(parts) == 3 else (parts[0], "msg", parts[-1]))
    return f"{parts[0]}/{parts[-1]}"


def closure(root: Definition, types: dict[str, Definition]) -> Schema:
    """Return ``root`` with all types that it nests, taken from ``types``.

    Raises `MessageTypeError` if ``types`` lacks a definition, a type contains itself, or the nesting is too deep.
    """
    done: dict[str, Definition] = {}

    def visit(definition: Definition, path: tuple[str, ...]) -> None:
        if definition.name in path:
            raise MessageTypeError(f"{root.name} cannot be used: {definition.name} contains itself")
        if len(path) > MAX_DEPTH:
            raise MessageTypeError(f"{root.name} cannot be used: its types are nested more than {MAX_DEPTH} deep")
        if definition.name in done:
            return
        for name in definition.nested_names():
            if name not in types:
                msg = f"{root.name} nests {name}, whose definition is unknown"
                raise MessageTypeError(
                    msg,
                    f"install the package {name.split('/')[0]} or add a folder with its .msg files to types.folders",
                )
            visit(types[name], (*path, definition.name))
        done[definition.name] = definition

    visit(root, ())
    return Schema(root, done)


def parse_type(text: str, owner: str, world: World) -> FieldType:
    """Read a field's type; raises `ValueError` with the reason."""
    match = _TYPE.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a type")
    base, string_bound, bounded, count = match.group(1, 2, 3, 4)
    shape, length = Shape.SINGLE, int(count or 0)
    if "[" in text:
        shape = Shape.ARRAY if count and not bounded else Shape.SEQUENCE
    if length > MAX_ARRAY or int(string_bound or 0) > MAX_ARRAY or (shape is Shape.ARRAY and not length):
        raise ValueError(f"array length or bound of {text!r} is not between 1 and {MAX_ARRAY}")
    if string_bound and base not in STRING_TYPES:
        raise ValueError(f"only strings can have a bound on their own length, not {base}")
    base = _base_name(base, owner, world)
    if world is World.ROS1:
        return FieldType(base, shape, length if shape is Shape.ARRAY else 0)
    return FieldType(base, shape, length, int(string_bound or 0))


def _base_name(base: str, owner: str, world: World) -> str:
    if base in PRIMITIVE_SIZES or base in STRING_TYPES:
        return base
    if base in TIME_TYPES:
        return base if world is World.ROS1 else TIME_TYPES[base]
    name = spell(base, owner, world)
    return _BUILTIN_TIMES.get(name, name) if world is World.ROS1 else name


def _read_line(line: str, bare: str, owner: str, world: World, fields: list[Field], constants: list[Constant]) -> bool:
    """Read one line; return whether it is in the syntax of ``world`` itself."""
    match = _LINE.fullmatch(bare) if len(bare) <= MAX_LINE else None
    if match is None:
        raise ValueError("expected '<type> <name>'" if len(bare) <= MAX_LINE else f"longer than {MAX_LINE} characters")
    type_text, name, remainder = match.groups()
    if remainder.startswith("="):
        if type_text.split("<=")[0] in STRING_TYPES and world is World.ROS1:
            # the value of a string constant in ROS 1 is everything after the '=', including a '#'
            remainder = "=" + line.split("=", 1)[1]
        constant = Constant(name, parse_type(type_text, owner, world).base, remainder[1:].strip())
        constants.append(constant)
        other = World.ROS2 if world is World.ROS1 else World.ROS1
        if not is_readable(constant, other):
            constant_value(constant, world)
        return is_readable(constant, world) and (world is World.ROS1 or is_legal_constant(name))
    field_type = parse_type(type_text, owner, world)
    if world is World.ROS1:
        fields.append(Field(name, field_type))
        return not remainder and _FOREIGN_TO_ROS1.search(type_text) is None
    fields.append(Field(name, field_type, parse_default(remainder, field_type) if remainder else None))
    native = is_legal_field(name) and _FOREIGN_TO_ROS2.match(type_text) is None
    return native and ("/msg/" not in field_type.base or is_legal_type(field_type.base))


def parse_default(text: str, field_type: FieldType) -> DefaultValue:
    """Read a ROS 2 default value; raises `ValueError` with the reason."""
    if field_type.nested:
        raise ValueError(f"a field of type {field_type.base} cannot have a default value")
    if field_type.shape is Shape.SINGLE:
        return _scalar(text, field_type.base)
    if not (text.startswith("[") and text.endswith("]")):
        raise ValueError(f"the default of an array must be a list in brackets, not {text!r}")
    values = tuple(_scalar(item, field_type.base) for item in _split_list(text[1:-1]))
    if field_type.shape is Shape.ARRAY and len(values) != field_type.length:
        raise ValueError(f"{len(values)} default values for {field_type.length} elements")
    return values


def _scalar(text: str, base: str) -> DefaultValue:
    text = text.strip()
    if base in STRING_TYPES:
        return _unquoted(text) if _QUOTED.fullmatch(text) else text
    if base == "bool":
        if text.lower() in ("true", "1"):
            return True
        if text.lower() in ("false", "0"):
            return False
        raise ValueError(f"{text!r} is not a bool")
    return float(text) if base.startswith("float") else int(text, 0)


def _unquoted(text: str) -> str:
    """Return a quoted text without its quotes, and with its escapes resolved as in Python; raises `ValueError`."""
    try:
        return str(ast.literal_eval(text))
    except SyntaxError as err:
        raise ValueError(f"{text!r} is not a valid string: {err.msg}") from None


def _split_list(text: str) -> Iterator[str]:
    for match in re.finditer(r"""\s*("(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|[^,]+?)\s*(?:,|$)""", text):
        yield match.group(1)


def _strip_comment(line: str) -> str:
    """Return the line without its comment; a ``#`` within quotes belongs to the value."""
    if "#" not in line:
        return line.strip()
    before = _BEFORE_VALUE.match(line)
    equals = line.find("=")
    first = before.end() if before is not None else len(line)
    last = equals if equals >= 0 else len(line)
    quote = ""
    for index, char in enumerate(line):
        if quote:
            if char == quote:
                quote = ""
        elif char in "\"'" and first <= index <= last:
            quote = char
        elif char == "#":
            return line[:index].strip()
    return line.strip()


_NESTED_LINE = "=" * 80


def own_text(definition: Definition) -> str:
    """Return the type's own definition: its author's text, or else a text made from the constants and fields."""
    if definition.text:
        return definition.text
    lines = [_constant(constant, definition.world) for constant in definition.constants]
    lines += [_field(field) for field in definition.fields]
    return "\n".join(lines) + "\n"


def full_text(schema: Schema) -> str:
    """Return the type's definition, then that of each nested type after lines of ``=`` and ``MSG: package/Name``."""
    parts = [own_text(schema.root).rstrip("\n")]
    for name in schema.nested_order():
        main = own_text(schema.types[name]).rstrip("\n")
        # genpy expects a line of text even for an empty type (genpy/dynamic.py)
        parts.append(f"{_NESTED_LINE}\nMSG: {_short(name)}\n{main}")
    return "\n".join(parts) + "\n"


def _constant(constant: Constant, world: World) -> str:
    if constant.base == "string" and world is World.ROS2 and not _QUOTED.fullmatch(constant.text):
        return f"string {constant.name}={_quoted(constant.text)}"
    return f"{constant.base} {constant.name}={constant.text}"


def _field(field: Field) -> str:
    kind = (
        str(field.type).replace(field.type.base, _short(field.type.base), 1) if field.type.nested else str(field.type)
    )
    default = "" if field.default is None else f" {_default(field.default)}"
    return f"{kind} {field.name}{default}"


def _default(value: DefaultValue) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_default(item) for item in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    return _quoted(value) if isinstance(value, str) else repr(value)


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _short(name: str) -> str:
    return name.replace("/msg/", "/", 1)
