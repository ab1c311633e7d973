"""The values in a Bottle, as plain Python values.

==================  ==============================  ===========================================
Python              on the wire                     in text
==================  ==============================  ===========================================
int                 INT32, INT64 if it is too large  ``5``
float               FLOAT64                         ``1.5``
str                 STRING (UTF-8)                  ``word`` or ``"two words"``
bytes               BLOB                            ``{1 2 255}``
bool                VOCAB32, '1' or 0               ``true``, ``false``
list, tuple         LIST                            ``(1 2)``
dict                DICT                            ``((key value) ...)``
Vocab               VOCAB32, or 64 beyond 4 letters  ``[set]``
Int8, Int16, Int64  INT8, INT16, INT64              ``5``
Float32             FLOAT32                         ``1.5``
==================  ==============================  ===========================================

The subclasses only remember how a value is written; they compare and compute as what they are. numpy arrays of numbers
are lists, written by their own type (unsigned ones with the tag of the signed type of their size, as YARP's vectors
are). Bytes of a string that are no UTF-8 become surrogate escapes, and the same bytes again.

A dict's entry is a list on the wire, the key before the values. One value stands for itself, any other number of them
for a tuple: ``{"n": 1, "GROUP": (["a", 1], ["b", 2])}`` is ``((GROUP (a 1) (b 2)) (n 1))``. So is, to be written only,
``{"n": 1, "GROUP": Group(a=1, b=2)}``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


class Int8(int):
    """An int written in one byte."""

    __slots__ = ()


class Int16(int):
    """An int written in two bytes."""

    __slots__ = ()


class Int64(int):
    """An int written in eight bytes, also where four would do."""

    __slots__ = ()


class Float32(float):
    """A float written in four bytes; it may hold more digits than are written."""

    __slots__ = ()


class Vocab(str):
    """A word of up to eight one-byte characters, written as a number: four bytes, beyond four characters eight.

    YARP 3 has no eight-byte vocab: there the first four characters are written, which is what its programs do.
    """

    __slots__ = ()


class Key(str):
    """A dict's key that is no string on the wire; it compares as the string that it is looked for by.

    Attributes:
        value: what it is on the wire.
    """

    __slots__ = ("value",)
    value: Any

    @classmethod
    def of(cls, value: Any, text: str) -> Key:
        """The key for a value whose text this is."""
        made = cls(text)
        made.value = value
        return made


class Group(dict[str, Any]):
    """A dict whose entries are the values after its key in the dict around it."""


class Vocab64(Vocab):
    """A vocab written in eight bytes, also where four would do (YARP 4)."""

    __slots__ = ()


def begun_by_vocab(values: Sequence[Any]) -> Sequence[Any]:
    """Values of an answer whose first, where it is a text in brackets (``[many]``, ``[ok]``), becomes that vocab."""
    match values:
        case [str(word), *rest] if word.startswith("[") and word.endswith("]"):
            return [Vocab(word[1:-1]), *rest]
    return values
