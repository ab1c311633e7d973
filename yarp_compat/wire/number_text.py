"""Numbers as YARP reads them in a text: by C's `strtoll` and `strtod` where a word looks like one, which is often."""

from __future__ import annotations

import math
import re

_INT = re.compile(r"[+-]?(?:0|[1-9][0-9]{0,17})")
_FLOAT = re.compile(r"[+-]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][+-]?[0-9]+)?")
_LIKE = re.compile(r"([0+\-]*)[0-9.eE+\-]*")
_LIKE_HEX = re.compile(r"([0+\-xX]*)[0-9.a-fA-F+\-]*")
_C_INT = re.compile(r"([+-]?)(?:0[xX]([0-9a-fA-F]+)|(0[0-7]*)|([1-9][0-9]*))")
_C_FLOAT = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_C_HEX_FLOAT = re.compile(r"[+-]?0[xX](?:[0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)")

_LARGEST = 2**63 - 1


def number(word: str) -> int | float | None:
    """The number that a word is to YARP; None where it is a string.

    Ints saturate at 64 bits. What looks like an int but is none counts as far as it is one: ``-`` is 0, ``1-2`` is 1,
    ``010`` is 8 (octal). What looks like a float but is none is 0.0: ``1.5-2`` (since YARP 3.6).
    """
    if _INT.fullmatch(word):
        return int(word)
    if _FLOAT.fullmatch(word) or word in ("inf", "-inf", "nan"):
        return float(word)
    if word[:1] not in "+-.0123456789" or word in ("", ".") or word.count(".") > 1:
        return None
    hexadecimal = "x" in word or "X" in word
    like = (_LIKE_HEX if hexadecimal else _LIKE).fullmatch(word)
    if like is None or like[1].count("+") + like[1].count("-") > 1:
        return None
    if hexadecimal and len(word) - 1 - max(word.rfind("x"), word.rfind("X")) > 8:
        return None
    if "." in word or (not hexadecimal and ("e" in word or "E" in word)):
        return _c_float(word)
    return _c_int(word)


def _c_int(word: str) -> int:
    """What `strtoll` with base 0 makes of the beginning of a word."""
    found = _C_INT.match(word)
    if found is None:
        return 0
    sign, hexadecimal, octal, decimal = found.groups()
    digits, base = (hexadecimal, 16) if hexadecimal else (octal, 8) if octal else (decimal, 10)
    digits = digits.lstrip("0") or "0"
    value = int(digits, base) if len(digits) <= 22 else math.inf
    if sign == "-":
        return int(max(-value, -_LARGEST - 1))
    return int(min(value, _LARGEST))


def _c_float(word: str) -> float:
    """What `strtod` makes of a word, all of which it must take."""
    if _C_HEX_FLOAT.fullmatch(word):
        return float.fromhex(word)
    return float(word) if _C_FLOAT.fullmatch(word) else 0.0
