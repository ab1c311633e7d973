"""Values of constants: how each world writes them, and how they are converted.

ROS 1 constants are read as in genmsg 0.6 (``msg_loader.convert_constant_value``): integers are decimal, ``byte`` has a
sign, a bool is a Python literal (``True``, ``1``), and a string is all that follows the ``=``. ROS 2 constants are read
as in rosidl_adapter 4.6 (``parser.parse_primitive_value_string``): integers may have a prefix such as ``0x``, a bool is
``true``, ``false``, ``0`` or ``1`` in any case, and a string may have quotes.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable

from bridge.messages.definitions.names import legal_constants
from bridge.messages.definitions.schema import PRIMITIVE_SIZES, STRING_TYPES, Constant, World

Value = bool | int | float | str

_BOOLS = {"true": True, "1": True, "false": False, "0": False}
_MAX_LITERAL = 100  # maximum characters of a bool literal in ROS 1


def constant_value(constant: Constant, world: World) -> Value:
    """Return the value that ``world`` reads from a constant's text; raises `ValueError` if it cannot."""
    base, text = constant.base, constant.text
    if base in STRING_TYPES:
        return _string(base, text, world)
    if base.startswith("float"):
        return float(text)
    if base == "bool":
        return _bool(text, world)
    if base not in PRIMITIVE_SIZES:
        raise ValueError(f"a constant cannot be of type {base}")
    lowest, highest = _range(base, world)
    value = integer(text) if world is World.ROS2 else int(text)
    if not lowest <= value <= highest:
        raise ValueError(f"{value} is not between {lowest} and {highest}")
    return value


def integer(text: str) -> int:
    """Return the integer that ROS 2 reads: decimal, with or without leading zeros (``08``), or prefixed (``0x1F``)."""
    try:
        return int(text)
    except ValueError:
        return int(text, 0)


def is_readable(constant: Constant, world: World) -> bool:
    """Whether ``world`` can read the constant's value."""
    try:
        constant_value(constant, world)
    except ValueError:
        return False
    return True


def ros1_constants(constants: Iterable[Constant]) -> tuple[Constant, ...]:
    """Return ROS 2 constants as ROS 1 writes them: bools as 1 and 0, decimal integers, strings without quotes.

    Constants of type wstring are left out, because ROS 1 has none.
    """
    return tuple(_ros1_constant(c) for c in constants if c.base != "wstring" and is_readable(c, World.ROS2))


def _ros1_constant(constant: Constant) -> Constant:
    value = constant_value(constant, World.ROS2)
    if isinstance(value, bool):
        return Constant(constant.name, constant.base, str(int(value)))
    if isinstance(value, str):
        return Constant(constant.name, constant.base, value)
    if constant.base == "byte" and isinstance(value, int) and value > 127:
        return Constant(constant.name, constant.base, str(value - 256))
    if is_readable(constant, World.ROS1):
        return constant
    return Constant(constant.name, constant.base, str(value))


def ros2_constants(constants: Iterable[Constant]) -> tuple[Constant, ...]:
    """Return ROS 1 constants as ROS 2 writes them: upper-case names, ``true`` and ``false``, unsigned octets."""
    constants = [c for c in constants if is_readable(c, World.ROS1) or is_readable(c, World.ROS2)]
    names = legal_constants(constant.name for constant in constants)
    return tuple(_ros2_constant(names[constant.name], constant) for constant in constants)


def _ros2_constant(name: str, constant: Constant) -> Constant:
    text = constant.text
    if constant.base in STRING_TYPES:
        if text[:1] in ("'", '"'):
            text = '"' + text.replace('"', '\\"') + '"'
    elif not is_readable(constant, World.ROS2):
        value = constant_value(constant, World.ROS1)
        text = str(value).lower() if isinstance(value, bool) else str(int(value) & 0xFF)
    return Constant(name, constant.base, text)


def _string(base: str, text: str, world: World) -> str:
    if world is World.ROS1:
        if base == "wstring":
            raise ValueError("ROS 1 has no wstring")
        return text
    quote = text[:1]
    if not quote or quote not in "\"'" or not text.endswith(quote):
        return text
    inner = text[1:-1]
    if re.search(rf"(?<!\\){quote}", inner):
        raise ValueError(f"{text!r} has a quote without a backslash before it")
    return inner.replace(f"\\{quote}", quote)


def _bool(text: str, world: World) -> bool:
    if world is World.ROS2:
        if text.lower() not in _BOOLS:
            raise ValueError(f"{text!r} is not a bool; ROS 2 writes true or false")
        return _BOOLS[text.lower()]
    try:
        if len(text) <= _MAX_LITERAL:
            return bool(ast.literal_eval(text))
    except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError):
        pass
    raise ValueError(f"{text[:_MAX_LITERAL]!r} is not a bool; ROS 1 writes True, False, 1 or 0")


def _range(base: str, world: World) -> tuple[int, int]:
    """Return the least and the greatest value of an integer type; ROS 1's byte has a sign, ROS 2's does not."""
    if base in ("byte", "char"):
        base = "int8" if base == "byte" and world is World.ROS1 else "uint8"
    bits = int(base.partition("int")[2])
    return (0, 2**bits - 1) if base.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
