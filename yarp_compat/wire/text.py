r"""The text form of Bottles, for people, text carriers, envelopes and name servers.

Separators are space, tab, newline, carriage return and comma. ``(...)`` is a list, ``{1 2 255}`` a blob, ``[word]`` a
vocab, ``"..."`` a string with the escapes ``\\ \" \n \r \0``; other words are numbers, ``true``, ``false``, ``null`` or
strings (`yarp/os/impl/BottleImpl.cpp` and `Storable.cpp`; measured on YARP 4.0). YARP accepts any text, and drops a
last part whose bracket or quote is not closed; so does this module.
"""

from __future__ import annotations

import contextlib
import math
import re
import struct
from collections.abc import Iterable
from typing import Any

from yarp_compat.wire.errors import WireError
from yarp_compat.wire.tags import MAX_DEPTH
from yarp_compat.wire.values import DictKey, Float32, Vocab, Vocab64, entries_of, merge, plain, vocab32, vocab64

LARGEST_WORK = 4 << 20  # maximum characters parsed repeatedly in a text that is not well-formed

_NEXT = re.compile(
    r"""[ \t\n\r,]*+ (?: (\() | (?:
        (\)) | ( [^ \t\n\r,"\\(){}]++ | "(?>[^"\\]++|\\.)*+" | \{[^(){}"\\]*+\} )
    ) (?=[ \t\n\r,)]|\Z) )""",
    re.DOTALL | re.VERBOSE,
)
"""The next token of a well-formed text: a list begins (1) or ends (2), or another word follows (3)."""
_SPECIAL = re.compile(r'[\\"(){}]')
_WORDS = re.compile(r"[^ \t\n\r,]+")
_MARK = re.compile(r'\\.|[ \t\n\r,"(){}]', re.DOTALL)
_SEPARATORS = " \t\n\r,"
_LISTS = {"(": 1, ")": -1}
_BLOBS = {"{": 1, "}": -1}
_NUMERIC = frozenset("0123456789+-.in")
_TRUTHS: dict[str, Any] = {"true": True, "false": False}
_NAMES: dict[str, Any] = {**_TRUTHS, "null": Vocab("null")}
_ESCAPE = re.compile(r"\\(.?)", re.DOTALL)
_ESCAPED = {"n": "\n", "r": "\r", "0": "\0"}

_PLAIN_WORD = re.compile(r"[A-Za-z_][A-Za-z_0-9.\-]*")
_PLAIN_NUMBERS = re.compile(r"[0-9 ]*")
_ESCAPES = str.maketrans({"\n": "\\n", "\r": "\\r", "\0": "\\0", "\\": "\\\\", '"': '\\"'})


_INT = re.compile(r"[+-]?(?:0|[1-9][0-9]{0,17})")
_FLOAT = re.compile(r"[+-]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][+-]?[0-9]+)?")
_LIKE = re.compile(r"([0+\-]*)[0-9.eE+\-]*")
_LIKE_HEX = re.compile(r"([0+\-xX]*)[0-9.a-fA-F+\-]*")
_C_INT = re.compile(r"([+-]?)(?:0[xX]([0-9a-fA-F]+)|(0[0-7]*)|([1-9][0-9]*))")
_C_FLOAT = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_C_HEX_FLOAT = re.compile(r"[+-]?0[xX](?:[0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)")

_LARGEST = 2**63 - 1


def from_text(text: str) -> list[Any]:
    """Parse a Bottle's text; raises `WireError` if lists are nested too deep, or parsing would take too long."""
    if _SPECIAL.search(text) is None:
        return [_value(token) for token in _WORDS.findall(text)]
    at = 0
    values: list[Any] = []
    outer: list[list[Any]] = []
    while token := _NEXT.match(text, at):
        at = token.end()
        kind = token.lastindex
        if kind == 3:
            values.append(_value(token[3]))
        elif kind == 1:
            if len(outer) == MAX_DEPTH:
                raise WireError(f"lists in a text are nested deeper than {MAX_DEPTH} at character {at}")
            outer.append(values)
            values = []
        elif outer:
            outer[-1].append(values)
            values = outer.pop()
        else:
            break
    else:
        if not outer and not text[at:].strip(_SEPARATORS):
            return values
    return TextReader(text).values(text, 0)


def is_complete(text: str) -> bool:
    """Return whether brackets and quotes are closed; if not, the text continues in the next line."""
    return split_words(text)[1]


def to_text(values: Iterable[Any]) -> str:
    """Return the text of a Bottle with these values; raises `WireError` for unsupported values."""
    return _joined(values, 0)


def value_text(value: Any) -> str:
    """Return the text of one value inside a Bottle: strings quoted if needed, lists in brackets."""
    return _printed(value, 0)


def plain_text(value: Any) -> str:
    """Return the text of one value without its marks: quotes of strings, brackets of vocabs, blobs and lists."""
    if isinstance(value, str) and not isinstance(value, Vocab):
        return value
    text = value_text(value)
    return text[1:-1] if text[0] in "([{" else text


def dict_of(entries: list[Any]) -> dict[str, Any]:
    """Return a dict from lists of a key and its values; the last list of a key counts, other elements are ignored."""
    entries_by_key: dict[str, Any] = {}
    for entry in entries:
        if isinstance(entry, list):
            key, *values = entry or [None]
            if type(key) is not str:
                key = DictKey.of(key, "" if key is None else plain_text(key))
            merge(entries_by_key, {key: values[0] if len(values) == 1 else tuple(values)})
    return entries_by_key


class TextReader:
    """A parser of any text, as in YARP: a list's text is between the first and last character of its word.

    It parses a text once more for each level of nesting, so it is not used for well-formed texts.
    """

    def __init__(self, text: str) -> None:
        self._left = LARGEST_WORK + len(text)

    def values(self, text: str, depth: int) -> list[Any]:
        """Parse a list's text without its brackets."""
        self._left -= len(text)
        if depth > MAX_DEPTH or self._left < 0:
            raise WireError(f"lists in a text are nested deeper than {MAX_DEPTH}, or too deep for its length")
        return [self._value(token, depth + 1) for token in split_words(text)[0]]

    def _value(self, word: str, depth: int) -> Any:
        if word[0] == "(":
            return self.values(word[1:-1], depth)
        if word[0] == "{":
            return bytes([_low_byte(value) for value in self.values(word[1:-1], depth)])
        return _value(word)


def _value(word: str) -> Any:
    """Parse a word, except lists, and blobs that contain brackets or quotes."""
    if word in _NAMES:
        return _NAMES[word]
    first = word[0]
    if first in _NUMERIC and (value := number(word)) is not None:
        return value
    if first == "[":
        return _read_vocab(word[1:-1])
    if first == "{":
        return _blob(word[1:-1])
    text = word[1:-1] if first == '"' else word
    if "\\" in text:
        text = _ESCAPE.sub(lambda match: _ESCAPED.get(match[1], match[1]), text)
        if first != '"':
            return _TRUTHS.get(text, text)
    return text


def _blob(text: str) -> bytes:
    if _PLAIN_NUMBERS.fullmatch(text):
        with contextlib.suppress(ValueError):
            return bytes(map(int, text.split()))
    return bytes([_low_byte(value) for value in from_text(text)])


def split_words(text: str) -> tuple[list[str], bool]:
    """Split the outermost level of a text into words; return also whether all brackets and quotes are closed."""
    tokens: list[str] = []
    begun = -1
    quoted = False
    lists = blobs = done = 0
    for mark in _MARK.finditer(text + " "):
        at, char = mark.start(), mark[0]
        if begun < 0 and at > done:
            begun = done
        done = mark.end()
        if char in _SEPARATORS:
            if begun >= 0 and not (quoted or lists or blobs):
                tokens.append(text[begun:at])
                begun = -1
            continue
        if begun < 0:
            begun = at
        if char == '"':
            quoted = not quoted
        elif not quoted:
            lists += _LISTS.get(char, 0)
            blobs += _BLOBS.get(char, 0)
    return tokens, not (quoted or lists or blobs)


def _read_vocab(letters: str) -> Vocab | bool:
    data = letters.encode(errors="surrogateescape")
    if len(data) > 4:
        return vocab64(int.from_bytes(data[:8].ljust(8, b"\0"), "little", signed=True))
    return vocab32(int.from_bytes(data.ljust(4, b"\0"), "little", signed=True))


def _low_byte(value: Any) -> int:
    """Return the byte for a value in a blob."""
    if value is True:
        return 0x31
    if isinstance(value, Vocab):
        return value.encode(errors="surrogateescape")[0]
    if isinstance(value, float):
        return int(value) & 255 if abs(value) < 2**31 else 0
    return value & 255 if isinstance(value, int) else 0


def _joined(values: Iterable[Any], depth: int) -> str:
    if depth > MAX_DEPTH:
        raise WireError(f"lists are nested deeper than {MAX_DEPTH}")
    return " ".join([_printed(value, depth) for value in values])


def _printed(value: Any, depth: int) -> str:
    kind = type(value)
    if kind is float:
        return _print_float(value)
    if kind is str:
        plainly = _PLAIN_WORD.fullmatch(value) and value not in _TRUTHS
        return value if plainly else f'"{value.translate(_ESCAPES)}"'
    if kind is int:
        return str(value)
    if kind is bool:
        return "true" if value else "false"
    if kind is list or kind is tuple:
        return f"({_joined(value, depth + 1)})"
    if kind is Vocab or kind is Vocab64:
        letters = value.replace("\0", "")
        return f"[{letters}]" if letters not in ("", "1") else "true" if letters else "false"
    if kind is bytes:
        return "{" + " ".join(map(str, value)) + "}"
    if kind is dict:
        return f"({_joined(entries_of(value), depth + 1)})"
    if kind is Float32:
        return _print_float(rounded(value))
    if isinstance(value, int):
        return int.__repr__(value)
    converted = plain(value)
    return f"({_joined(converted, depth + 1)})" if hasattr(converted, "dtype") else _printed(converted, depth)


def _print_float(value: float) -> str:
    text = f"{value:.21g}"
    return text if "." in text or "e" in text or "n" in text else text + ".0"


def rounded(value: float) -> float:
    """Round a float to four bytes; raises `WireError` if it is too large."""
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        raise WireError(f"{value!r} is too large for four bytes") from None


def number(word: str) -> int | float | None:
    """Parse a word as YARP's number; return None if it is a string.

    Ints saturate at 64 bits. Of malformed ints, the valid beginning counts: ``-`` is 0, ``1-2`` is 1, ``010`` is 8
    (octal). Malformed floats are 0.0: ``1.5-2`` (since YARP 3.6).
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
    """Parse the int at the beginning of a word like `strtoll` with base 0."""
    match = _C_INT.match(word)
    if match is None:
        return 0
    sign, hexadecimal, octal, decimal = match.groups()
    digits, base = (hexadecimal, 16) if hexadecimal else (octal, 8) if octal else (decimal, 10)
    digits = digits.lstrip("0") or "0"
    value = int(digits, base) if len(digits) <= 22 else math.inf
    if sign == "-":
        return int(max(-value, -_LARGEST - 1))
    return int(min(value, _LARGEST))


def _c_float(word: str) -> float:
    """Parse a whole word like `strtod`; 0.0 if it is malformed."""
    if _C_HEX_FLOAT.fullmatch(word):
        return float.fromhex(word)
    return float(word) if _C_FLOAT.fullmatch(word) else 0.0
