"""Requests and responses of an XML-RPC server: HTTP headers and XML, checked against limits."""

from __future__ import annotations

import http
import re
import xmlrpc.client
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any
from xml.parsers import expat

from typing_extensions import override

_PATHS = ("/", "/RPC2")
"""Python's clients replace an empty path with /RPC2."""

_NO_XML = re.compile(r"[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")

_INVALID = (expat.ExpatError, xmlrpc.client.Error, ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Exceptions that Python's XML-RPC parser raises for invalid documents."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a server.

    Attributes:
        connections: number of open connections; beyond it, the connection that has been idle longest is closed; if no
            connection is idle, new clients wait.
        body: size of one request in bytes.
        buffered: total size in bytes of all requests that are being received or served.
        head: size of a request's HTTP header in bytes.
        depth: levels of nested arrays and structures.
        values: number of values in one request.
        seconds: time for a whole request to arrive, and for a whole response to be accepted; see also `SLOWEST`.
        threads: number of threads that run methods.
        response: size of the response to one ``system.multicall`` in bytes.
    """

    connections: int = 1024
    body: int = 16 * 2**20
    buffered: int = 64 * 2**20
    head: int = 16 * 1024
    depth: int = 64
    values: int = 200_000
    seconds: float = 10.0
    threads: int = 4
    response: int = 64 * 2**20


DEFAULT_LIMITS = Limits()

SLOWEST = 100_000
"""Slowest accepted rate in bytes per second; a request or response may take its size divided by this rate longer."""


class _Decoder(xmlrpc.client.Unmarshaller):
    """Python's decoder, with limits."""

    def __init__(self, limits: Limits) -> None:
        super().__init__()
        self._depth_limit, self._values_left = limits.depth, limits.values
        self._depth = 0

    @override
    def start(self, tag: str, attrs: dict[str, str]) -> None:
        if tag in ("array", "struct"):
            self._depth += 1
            if self._depth > self._depth_limit:
                raise ValueError(f"values are nested deeper than {self._depth_limit} levels")
        elif tag == "value":
            self._values_left -= 1
            if self._values_left < 0:
                raise ValueError("too many values in one request")
        super().start(tag, attrs)

    @override
    def end(self, tag: str) -> None:
        if tag in ("array", "struct"):
            self._depth -= 1
        super().end(tag)


def decode_call(body: bytes, limits: Limits) -> tuple[str, tuple[Any, ...]]:
    """Return the method and parameters of a request; raises `xmlrpc.client.Fault` if it is invalid."""
    decoder = _Decoder(limits)
    try:
        params = _parse(decoder, body)
    except _INVALID as err:
        raise xmlrpc.client.Fault(xmlrpc.client.NOT_WELLFORMED_ERROR, f"not an XML-RPC request: {err}") from None
    method = decoder.getmethodname()
    if not isinstance(method, str):
        raise xmlrpc.client.Fault(xmlrpc.client.INVALID_XMLRPC, "not an XML-RPC request: it names no method")
    return method, params


def decode_response(body: bytes, depth: int = DEFAULT_LIMITS.depth) -> Any:
    """Return the value of a response; raises `xmlrpc.client.Fault` if it is a fault, `ValueError` if it is invalid."""
    try:
        values = _parse(xmlrpc.client.Unmarshaller(), body)
    except xmlrpc.client.Fault:
        raise
    except _INVALID as err:
        raise ValueError(err) from None
    level: list[Any] = [values]
    for _ in range(depth + 2):  # comparing and printing deeper values would fail
        level = [item for part in level for item in (part.values() if isinstance(part, dict) else part)]
        level = [item for item in level if isinstance(item, list | dict)]
        if not level:
            return values[0] if values else None
    raise ValueError(f"values are nested deeper than {depth} levels")


def _parse(decoder: xmlrpc.client.Unmarshaller, body: bytes) -> tuple[Any, ...]:
    decoder.xml("", None)  # without an encoding, because expat has decoded the text
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = decoder.start
    parser.EndElementHandler = decoder.end
    parser.CharacterDataHandler = decoder.data
    parser.StartDoctypeDeclHandler = _refuse_doctype
    parser.Parse(body, True)
    return tuple(decoder.close())


def _refuse_doctype(*_: object) -> None:
    raise ValueError("a document type declaration is not accepted")  # with it, entities could expand without limit


class HttpError(Exception):
    """A request that the server rejects with an HTTP status; the connection is closed."""

    def __init__(self, status: http.HTTPStatus) -> None:
        super().__init__(status.phrase)
        self.status = status


@dataclass(frozen=True, slots=True)
class Head:
    """The parts of an HTTP header that matter.

    ``length`` is the size of the body in bytes; ``persistent``: the connection stays open after the response;
    ``wants_continue``: the client waits for "100 Continue" before it sends the body.
    """

    length: int
    persistent: bool
    wants_continue: bool


def parse_head(data: bytes, limit: int) -> Head:
    """Parse an HTTP header; raises `HttpError`."""
    lines = data.decode("latin-1").split("\r\n")
    words = lines[0].split()
    if len(words) != 3 or not words[2].startswith("HTTP/1."):
        raise HttpError(http.HTTPStatus.BAD_REQUEST)
    if words[0] != "POST":
        raise HttpError(http.HTTPStatus.NOT_IMPLEMENTED)
    if words[1] not in _PATHS:
        raise HttpError(http.HTTPStatus.NOT_FOUND)
    fields: dict[str, str] = {}
    for line in lines[1:]:
        name, colon, value = line.partition(":")
        name = name.lower()
        if not colon or (name == "content-length" and name in fields):
            raise HttpError(http.HTTPStatus.BAD_REQUEST)
        fields[name] = value.strip()
    if fields.get("content-encoding", "identity").lower() != "identity":
        raise HttpError(http.HTTPStatus.NOT_IMPLEMENTED)
    size = fields.get("content-length", "")
    if not size or "transfer-encoding" in fields:
        raise HttpError(http.HTTPStatus.LENGTH_REQUIRED)
    if not (size.isascii() and size.isdigit()):
        raise HttpError(http.HTTPStatus.BAD_REQUEST)
    if len(size) > 12 or int(size) > limit:
        raise HttpError(http.HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
    option = fields.get("connection", "").lower()
    persistent = option != "close" and (words[2] != "HTTP/1.0" or option == "keep-alive")
    return Head(int(size), persistent, fields.get("expect", "").lower() == "100-continue")


_HEAD = "<?xml version='1.0'?>\n<methodResponse>\n<params>\n<param>\n"
_TAIL = "</param>\n</params>\n</methodResponse>\n"


def encode_response(result: object) -> bytes:
    """Return the XML of a response; raises `TypeError` or `OverflowError` if XML-RPC cannot represent the value."""
    fault = isinstance(result, xmlrpc.client.Fault)
    return _encode(xmlrpc.client.dumps(result if fault else (result,), methodresponse=True))  # type: ignore[arg-type]


def encode_responses(results: Iterable[object], limits: Limits) -> bytes:
    """Return the XML of a list of results; raises `xmlrpc.client.Fault` at the first result that exceeds the limit."""
    parts, size = [], 0
    for result in results:
        part = encode_response(result)[len(_HEAD) : -len(_TAIL)]
        size += len(part)
        if size > limits.response:
            raise xmlrpc.client.Fault(xmlrpc.client.INTERNAL_ERROR, f"the response exceeds {limits.response} bytes")
        parts.append(part)
    values = b"".join(parts)
    return f"{_HEAD}<value><array><data>\n".encode() + values + f"</data></array></value>\n{_TAIL}".encode()


def _encode(text: str) -> bytes:
    """Encode XML; U+FFFD replaces characters that XML does not allow, since names of nodes may contain any bytes."""
    return _NO_XML.sub("\ufffd", text).encode()
