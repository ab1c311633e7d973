"""String constants and default values in definitions, in a form that ROS 2's generators read correctly.

Several steps process a text on its path to C and Python: rosidl_adapter removes quotes, resolves Python's escapes and
writes IDL in Latin-1, and rosidl_parser resolves IDL's escapes and reads UTF-8 (rosidl 4.6). So escaped quotes and
characters beyond ASCII arrive unchanged, but some backslashes do not. In the elements of arrays, only Python's escapes
are resolved; there, a non-ASCII character or several escaped quotes make the generators fail.
"""

from __future__ import annotations

import re
import warnings

from bridge.messages.definitions.schema import FieldType, Shape
from bridge.messages.definitions.text import parse_default

_SEQUENCE = FieldType("string", Shape.SEQUENCE)
_PLAIN = re.compile(r"[ !$-&(-<>-\[\]-~]")  # printable ASCII without quotes, backslash, number sign and equals sign
_IDL_ESCAPE = re.compile(r"""\\(?:[ntvbrfa\\?'"0-7x]|$)""")


def string_value(text: str, *, is_array: bool) -> str:
    """Return the default value or constant of a string, or the default of an array of strings, for the generators.

    Raises `ValueError` with the reason if the generators would fail or change the text.
    """
    if not is_array:
        _check_scalar(text)
        return text.replace("=", r"\x3d")  # rosidl_adapter reads a line with an equals sign as a constant
    values = parse_default(text, _SEQUENCE)
    assert isinstance(values, tuple)
    return f"[{', '.join(map(_element, map(str, values)))}]"


def _check_scalar(text: str) -> None:
    quote = text[:1]
    if quote in ('"', "'") and text.endswith(quote):
        text = text[1:-1]
        if re.search(rf"(?<!\\){quote}", text):
            raise ValueError("it has a quote without a backslash before it")
        text = text.replace(f"\\{quote}", quote)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about escapes that Python does not know, which stay unchanged
            read = text.encode().decode("unicode_escape").encode("iso-8859-1").decode()
    except UnicodeError:
        raise ValueError("ROS 2 misreads the escapes of its characters; write them as they are") from None
    _check_printable(read)
    if _IDL_ESCAPE.search(read):
        raise ValueError("ROS 2 misreads its backslash")


def _element(text: str) -> str:
    """Return an element of an array of strings, with the characters escaped that the generators cannot read."""
    _check_printable(text)
    return '"' + "".join(char if _PLAIN.fullmatch(char) else _escape(ord(char)) for char in text) + '"'


def _escape(code: int) -> str:
    return f"\\x{code:02x}" if code < 0x80 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _check_printable(text: str) -> None:
    if any((ord(char) < 32 and char != "\t") or ord(char) == 127 for char in text):
        raise ValueError("it has a control character, which may come from an escape such as \\n")
