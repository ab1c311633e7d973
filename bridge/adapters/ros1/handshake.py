"""The TCPROS handshake: both peers send a header before the messages.

A header is a little-endian 32-bit length, then fields of ``<32-bit length>name=value``
(https://wiki.ros.org/ROS/TCPROS, https://wiki.ros.org/ROS/Connection%20Header).
"""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from bridge.adapters.ros1_peers import (
    DeadlineSocket,
    RefusedError,
    Ros1Error,
    Ros1ProtocolError,
    UnreachableError,
    ask,
    bracketed,
    unanswered,
)

MAX_HEADER = 2**20
"""Size limit of headers in bytes; the definition of the largest common type is about 20 kB."""

ORIGIN_FIELD = "midspan_origin"
"""Header field of all publishers and servers of Midspan; its value is the daemon's name."""

Header = Mapping[str, str]

_LENGTH = struct.Struct("<I")


def encode(fields: Header) -> bytes:
    """Serialize a TCPROS header."""
    lines = [f"{name}={value}".encode() for name, value in fields.items()]
    body = b"".join(_LENGTH.pack(len(line)) + line for line in lines)
    return _LENGTH.pack(len(body)) + body


def decode(body: bytes) -> dict[str, str]:
    """Parse a header without its leading length; raises `Ros1ProtocolError`."""
    fields: dict[str, str] = {}
    at = 0
    while at < len(body):
        if at + 4 > len(body):
            raise Ros1ProtocolError("the connection header ends within a field's length")
        (length,) = _LENGTH.unpack_from(body, at)
        line = body[at + 4 : at + 4 + length]
        at += 4 + length
        name, equals, value = line.partition(b"=")
        if len(line) != length or not equals:
            raise Ros1ProtocolError("a field of the connection header is truncated or has no '='")
        # definitions may contain names in any encoding
        fields[name.decode(errors="replace").strip()] = value.decode(errors="replace")
    return fields


def read_header(sock: DeadlineSocket) -> dict[str, str]:
    """Read one header and nothing after it, at most until the socket's deadline."""
    (length,) = _LENGTH.unpack(read_exactly(sock, 4))
    if length > MAX_HEADER:
        raise Ros1ProtocolError(f"the connection header announces {length} bytes, but the limit is {MAX_HEADER}")
    return decode(read_exactly(sock, length))


def read_exactly(sock: DeadlineSocket, count: int) -> bytes:
    """Read ``count`` bytes until the socket's deadline at most; raises `Ros1ProtocolError` if the peer closes first."""
    parts: list[bytes] = []
    while count:
        part = sock.recv(min(count, 65536))
        if not part:
            raise Ros1ProtocolError("the peer closed the connection within its header")
        parts.append(part)
        count -= len(part)
    return b"".join(parts)


def connect(caller: str, uri: str, topic: str, seconds: float) -> tuple[DeadlineSocket, dict[str, str]]:
    """Connect to a publisher as an any-type subscriber, and read its header; raises `Ros1Error`.

    ``caller`` is this node's name, ``uri`` the publishing node's XML-RPC address; ``seconds`` limit all steps together.
    """
    deadline = time.monotonic() + seconds
    reply = ask(uri, seconds, "requestTopic", caller, topic, [["TCPROS"]])
    host, port = _address(reply, uri)
    ours = {"callerid": caller, "topic": topic, "type": "*", "md5sum": "*", "message_definition": ""}
    return _greet(host, port, deadline, {**ours, "tcp_nodelay": "1"}, f"{uri} publishes")


def connect_service(
    caller: str, address: str, service: str, seconds: float, **fields: str
) -> tuple[DeadlineSocket, dict[str, str]]:
    """Connect to a service's server, and read its header; raises `Ros1Error`.

    ``address`` is the server's, as ``rosrpc://host:port``; ``seconds`` limit all steps together; ``fields`` are added
    to the sent header: ``md5sum`` ("*" for any), ``probe``, ``persistent``.
    """
    deadline = time.monotonic() + seconds
    try:
        parts = urlsplit(bracketed(address))
        host, port = parts.hostname or "", parts.port or 0
    except ValueError:
        host, port = "", 0
    if not host or not port:
        raise Ros1ProtocolError(
            f"not a ROS 1 service's address: {address[:200]!r} (it should look like rosrpc://host:port)"
        )
    ours = {"callerid": caller, "service": service, "tcp_nodelay": "1", **fields}
    return _greet(host, port, deadline, ours, f"{service} is served")


def _greet(host: str, port: int, deadline: float, ours: Header, what: str) -> tuple[DeadlineSocket, dict[str, str]]:
    try:
        sock = DeadlineSocket.connected(host, port, deadline)
    except OSError as err:
        raise unanswered(f"cannot connect to {host}:{port} where {what}", err) from None
    except ValueError as err:  # not a host name
        raise Ros1ProtocolError(f"{host!r:.200} is not a host, where {what}: {err}") from None
    try:
        return sock, _exchange_headers(sock, ours, f"{host}:{port}")
    except BaseException:
        sock.close()
        raise


def _exchange_headers(sock: DeadlineSocket, ours: Header, peer: str) -> dict[str, str]:
    try:
        sock.sendall(encode(ours))
        header = read_header(sock)
    except TimeoutError:
        raise UnreachableError(f"{peer} sends no connection header in time", silent=True) from None
    except OSError as err:
        raise UnreachableError(f"{peer} broke off the handshake: {err}") from None
    except Ros1ProtocolError as err:
        raise Ros1ProtocolError(f"{peer}: {err}") from None
    if "error" in header:
        raise RefusedError(header["error"])
    # A port of YARP 3 without a known type returns the received header, with "*" in it.
    if header.get("type") in (None, "", "*") or not header.get("md5sum"):
        raise Ros1ProtocolError(f"{peer} has no type in its connection header")
    return header


def _address(reply: Any, uri: str) -> tuple[str, int]:
    match reply:
        case ["TCPROS", str(host), int(port), *_] if 0 < port < 65536:
            return host, port
    raise Ros1Error(f"{uri} offers no TCPROS connection: {str(reply)[:200]}")
