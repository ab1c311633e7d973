"""The subset of HTTP that ports use with browsers and curl."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any
from urllib.parse import parse_qsl, unquote_plus, urlsplit

from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError

LONGEST_HEAD = 16 << 10  # maximum bytes of a request's lines and headers
LONGEST_BODY = 1 << 20  # maximum bytes of a form
_MOST_FIELDS = 100
_ALWAYS = "Connection: close\r\nX-Content-Type-Options: nosniff\r\n"


@dataclass(frozen=True, slots=True)
class PageRequest:
    """A browser's request.

    Attributes:
        target: the request target as sent.
        path: the target's path, decoded, without the leading slash; empty for ``/data=...``, ``/req=...`` and
            ``/admin=...``, which YARP's pages contain: their value is in ``query``.
        query: the target's fields; after `with_form` also those of the form.
        length: size of the body that follows, in bytes.
        foreign: whether the request comes from another site's page.
    """

    target: str
    path: str
    query: dict[str, str]
    length: int
    foreign: bool

    def with_form(self, body: bytes) -> PageRequest:
        """Return the request, with the fields of a form in ``query``."""
        fields = {**self.query, **_fields(body.decode(errors="replace"))}
        return PageRequest(self.target, self.path, fields, 0, self.foreign)


def parse(head: bytes) -> PageRequest:
    r"""Parse a request up to its empty line; raises `WireError` if invalid."""
    lines = head.decode("latin-1").replace("\r\n", "\n").split("\n")
    method, target, *_ = *lines[0].split(" "), ""
    if method not in ("GET", "POST") or not target.startswith("/"):
        raise WireError(f"invalid request: {lines[0][:60]!r}")
    headers = {}
    for line in lines[1:]:
        name, _, value = line.partition(":")
        headers[name.strip().lower()] = value.strip()
    length = headers.get("content-length", "0")
    digits = length.lstrip("0")  # leading zeros do not count, and Python refuses to convert thousands of digits
    if not length.isascii() or not length.isdigit() or int(digits[:10] or 0) > LONGEST_BODY:
        raise WireError(f"invalid Content-Length {length[:20]!r}: it must be a number up to {LONGEST_BODY}")
    origin = headers.get("origin", "")
    foreign = bool(origin) and not origin.endswith("//" + headers.get("host", ""))
    foreign = foreign or headers.get("sec-fetch-site") == "cross-site"
    path, query = _split(target)
    return PageRequest(target, path, query, int(digits or 0) if method == "POST" else 0, foreign)


def _split(target: str) -> tuple[str, dict[str, str]]:
    try:
        parts = urlsplit("http://port" + target)
    except ValueError as error:
        raise WireError(f"invalid address: {target[:60]!r}") from error
    path = parts.path[1:]
    query = _fields(parts.query)
    key, equals, value = path.partition("=")
    if equals and key in ("data", "req", "admin"):  # YARP's pages link to /data=list
        return "", {**query, key: unquote_plus(value)}
    return unquote_plus(path), query


def _fields(text: str) -> dict[str, str]:
    try:
        return dict(parse_qsl(text, keep_blank_values=True, max_num_fields=_MOST_FIELDS))
    except ValueError as error:
        raise WireError(f"the form is invalid, or has more than {_MOST_FIELDS} fields") from error


_MARKS = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#x27;"})


def _escaped(text: str) -> str:
    """Escape text for HTML, including quotes; Python's ``html`` would import a table of 2,000 names."""
    return text.translate(_MARKS)


def response(body: bytes, mime: str = "text/html; charset=utf-8", status: str = "200 OK") -> bytes:
    """Return a complete response."""
    kind = "".join(c for c in mime if c.isprintable())
    head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n{_ALWAYS}\r\n"
    return head.encode("latin-1", errors="replace") + body


STREAM_HEAD = (
    b"HTTP/1.1 200 OK\r\nContent-Type: text/plain; charset=utf-8\r\nTransfer-Encoding: chunked\r\n"
    b"Cache-Control: no-store\r\n\r\n"
)
"""The response header before the chunks with a port's messages."""
STREAM_END = b"0\r\n\r\n"


_LINKS = (("/", "connections"), ("/data=help", "help"), ("/r", "read"))


def page(name: str, lines: Sequence[str], names: PortContact | None = None) -> bytes:
    """Return a page about a port: links, a form for a message, and ``lines``.

    In lines that are registrations of tcp ports, the port's name becomes a link. ``names`` is the address of the name
    server, to which the link "All ports" leads.
    """
    body = "\n".join(_linked(line) for line in lines)
    title = _escaped(name)
    known = [(f"http://{names.host}:{names.port}/data=list", "All ports")] if names else []
    links = "&nbsp;&nbsp;".join(f'(<a href="{_escaped(to)}">{label}</a>)' for to, label in (*known, *_LINKS))
    return (
        f"<!DOCTYPE html><html><head><title>{title}</title></head><body bgcolor='#ffffcc'><h1>yarp port {title}</h1>\n"
        f"<p>{links}</p>\n"
        '<form method="post" action="/form"><input type=text name=data><input type=submit value="send data"></form>\n'
        f"<pre>\n{body}\n</pre></body></html>\n"
    ).encode(errors="replace")


def _linked(line: str) -> str:
    contact = PortContact.from_registration(line)
    if contact is None:
        return _escaped(line)
    name = _escaped(contact.name)
    if contact.carrier != "tcp":
        return f"{name:<30} ({_escaped(contact.uri)})"
    address = _escaped(f"http://{contact.host}:{contact.port}/")
    return f'<a href="{address}">{name}</a>{" " * max(1, 30 - len(contact.name))}({_escaped(contact.uri)})'


def as_json(values: Sequence[Any], outer: str = "auto") -> bytes:
    """Convert a Bottle to JSON by YARP's rules: a list of (key value) pairs becomes an object.

    A word before the pairs becomes the object's ``type``. A single pair without a word stays an array. ``outer`` is the
    form of the outermost list: ``dict``, ``list`` or ``auto``.
    """
    return json.dumps(_plain(values, outer), default=str).encode()


def _plain(value: Any, outer: str = "auto") -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return _struct(value, outer)
    if isinstance(value, float) and not isfinite(value):
        return str(value)
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    return value


def _struct(values: Sequence[Any], outer: str) -> Any:
    """Convert a list to an object (``dict``) or an array (``list``): its first word selects the form, else ``outer``.

    ``auto`` selects an object if the list has at least two elements, which are pairs except for a first word.
    """
    first = values[0] if values and isinstance(values[0], str) else ""
    if first in ("list", "dict"):
        outer, values, first = first, values[1:], ""
    pairs = values[1:] if first else values
    if outer == "auto":
        paired = all(isinstance(v, (list, tuple)) and len(v) == 2 for v in pairs)
        outer = "dict" if paired and len(values) > 1 else "list"
    if outer == "list":
        return [_plain(v) for v in values]
    document = {"type": str(first)} if first else {}
    return {**document, **{str(v[0]): _plain(v[1]) for v in pairs if isinstance(v, (list, tuple)) and len(v) > 1}}
