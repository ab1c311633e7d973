"""Plain Python values behind Value, Bottle and Property."""

from __future__ import annotations

import math
import operator
from typing import Any

from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.encoder import plain
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Float32, Group, Int8, Int16, Int64, Vocab, Vocab64

_LEAVES = frozenset({int, float, str, bool, bytes, Int8, Int16, Int64, Float32, Vocab, Vocab64})


def plain_of(value: Any) -> Any:
    """The plain value, with lists of its own, for something that is put into a Bottle.

    Raises:
        WireError: a Bottle cannot hold it.
    """
    if type(value) in _LEAVES:
        return value
    value = getattr(value, "plain", value)  # of a Value, a Bottle or a Property
    if isinstance(value, dict):
        made = {key: tuple(map(plain_of, i)) if isinstance(i, tuple) else plain_of(i) for key, i in value.items()}
        return Group(made) if isinstance(value, Group) else made
    if isinstance(value, (list, tuple)):
        return [plain_of(item) for item in value]
    if getattr(value, "ndim", 0):  # a numpy array: the numbers keep their types
        return decode(encode(value, Profile.YARP4), Profile.YARP4)
    value = plain(value)
    return plain_of(value) if isinstance(value, list) else value


def cloned(value: Any) -> Any:
    """A copy of a plain value with lists of its own."""
    return value if value is None or type(value) in _LEAVES else plain_of(value)


def integer(value: Any, bits: int) -> int:
    """An int that fits.

    Raises:
        TypeError: it is no int.
        OverflowError: it does not fit.
    """
    number = operator.index(value)
    if not -(1 << bits - 1) <= number < 1 << bits - 1:
        raise OverflowError(f"{number} does not fit into {bits} bits")
    return int(number)


def cut(value: float, bits: int) -> int:
    """The lowest bits of a number, as C++ casts it; what no int can hold is the smallest."""
    if isinstance(value, float):
        smallest = -(1 << max(bits, 32) - 1)
        value = int(value) if math.isfinite(value) and smallest <= value < -smallest else smallest
    half = 1 << bits - 1
    return (value + half & 2 * half - 1) - half


def code_of(word: str | bool, size: int) -> int:
    """The number of a vocab, or of a string taken as one."""
    if isinstance(word, bool):
        return 0x31 if word else 0
    return int.from_bytes(word.encode(errors="surrogateescape")[:size].ljust(size, b"\0"), "little", signed=True)
