"""An XML-RPC client for ROS 1 masters and nodes, with a deadline and a size limit for each response.

Used by the ROS 1 side and by other parts that query a master. Each method responds with ``[code, status message,
value]``; code 1 is success (https://wiki.ros.org/ROS/Master_API, https://wiki.ros.org/ROS/Slave_API).
"""

from __future__ import annotations

import contextlib
import http.client
import math
import socket
import time
import xmlrpc.client
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

from typing_extensions import override

from bridge import resources
from bridge.adapters.ros1.xmlrpc_request import decode_response


class Ros1Error(Exception):
    """Base class of the errors of this module."""


class UnreachableError(Ros1Error):
    """A master or node cannot be reached or does not respond in time.

    Attributes:
        refused: whether its host refused the connection.
        silent: whether its host accepted the connection.
    """

    def __init__(self, message: str, *, refused: bool = False, silent: bool = False) -> None:
        super().__init__(message)
        self.refused, self.silent = refused, silent


class Ros1ProtocolError(Ros1Error):
    """A peer's address or response violates the ROS 1 protocols."""


class RefusedError(Ros1Error):
    """A peer rejects the call, for example because it does not publish the topic or uses another type."""


class ExhaustedError(Ros1Error):
    """The process has no file descriptor left to connect with; the peer itself may be fine."""


EXHAUSTED = f"this process has no file descriptor left for the connection; {resources.RAISE}"


def unanswered(message: str, err: OSError) -> Ros1Error:
    """Return the error for a failed connection: `ExhaustedError`, or `UnreachableError` with ``message`` and reason."""
    # without a descriptor the resolver cannot resolve host names either, and reports an arbitrary errno
    peers = isinstance(err, ConnectionError | TimeoutError)
    exhausted = err.errno in resources.OUT or (not peers and not resources.has_descriptor())
    if exhausted:
        return ExhaustedError(EXHAUSTED)
    refused = isinstance(err, ConnectionRefusedError)
    return UnreachableError(f"{message}: {str(err) or type(err).__name__}", refused=refused)


class DeadlineSocket(socket.socket):
    """A TCP socket with one deadline for all operations.

    The timeout of a plain socket restarts with each operation, so a peer that sends a byte now and then would block a
    thread forever.
    """

    deadline = math.inf

    @classmethod
    def connected(cls, host: str, port: int, deadline: float) -> DeadlineSocket:
        """Connect; ``deadline`` is on the monotonic clock. Raises `OSError`."""
        left = deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError
        with socket.create_connection((host, port), timeout=left) as plain:
            # http.client sends a request in two parts; the second would wait 40 ms until the first is acknowledged
            plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return cls.adopt(plain, deadline)

    @classmethod
    def adopt(cls, plain: socket.socket, deadline: float) -> DeadlineSocket:
        """Take over the descriptor of a connected socket."""
        # with family and type, the constructor need not query them, which fails on macOS if the peer has disconnected
        sock = cls(plain.family, plain.type, plain.proto, fileno=plain.detach())
        sock.deadline = deadline
        return sock

    def _arm(self) -> None:
        if self.deadline == math.inf:
            self.settimeout(None)
            return
        left = self.deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError
        self.settimeout(left)

    @override
    def recv(self, *args: Any) -> bytes:
        """Receive like `socket.socket.recv`; raises `TimeoutError` at the deadline."""
        self._arm()
        return super().recv(*args)

    @override
    def recv_into(self, *args: Any) -> int:
        """Receive like `socket.socket.recv_into`; raises `TimeoutError` at the deadline."""
        self._arm()
        return super().recv_into(*args)

    @override
    def sendall(self, *args: Any) -> None:
        """Send like `socket.socket.sendall`; raises `TimeoutError` at the deadline."""
        self._arm()
        super().sendall(*args)


def bracketed(uri: str) -> str:
    """Return a URI with brackets around an IPv6 address; ROS 1 nodes omit the brackets if ROS_IP is the address."""
    scheme, slashes, rest = uri.partition("://")
    authority, slash, path = rest.partition("/")
    host, _, port = authority.rpartition(":")
    return f"{scheme}{slashes}[{host}]:{port}{slash}{path}" if ":" in host and "[" not in host else uri


MAX_ANSWER = 64 * 2**20
"""Size limit in bytes for a master's response; its state with 100,000 registrations is about 20 MB."""

MAX_NODE_ANSWER = 2**16
"""Size limit in bytes for a node's response; any program may register a node, and valid responses are short."""

_PIECE = 64 * 1024

Call = tuple[str, tuple[Any, ...]]


class _Connection(http.client.HTTPConnection):
    """HTTP over a socket with a deadline."""

    deadline = 0.0

    @override
    def connect(self) -> None:
        self.sock = DeadlineSocket.connected(self.host, self.port, self.deadline)


class XmlRpcClient:
    """A client of one XML-RPC server, with a persistent connection. Not thread-safe.

    ``timeout`` is the time in seconds for each request with its response, ``limit`` the size limit of a response in
    bytes. Raises `Ros1ProtocolError` if ``uri`` is invalid.
    """

    def __init__(self, uri: str, timeout: float, limit: int = MAX_ANSWER) -> None:
        try:
            parts = urlsplit(bracketed(uri))
            host = parts.hostname if parts.scheme == "http" else None
            self._http = _Connection(host or "", parts.port or 80)
        except (ValueError, http.client.InvalidURL):
            host = None
        if not host:
            raise Ros1ProtocolError(f"not a ROS 1 address: {uri[:200]!r} (it should look like http://host:11311/)")
        self.uri = uri
        self._path = parts.path or "/"
        self._timeout = timeout
        self._limit = limit
        self._asked: tuple[list[Call], str] = ([], "")
        self._last: tuple[bytes, bytes, Any] | None = None

    @property
    def size(self) -> int:
        """Size of the last response in bytes."""
        return len(self._last[1]) if self._last is not None else 0

    def call(self, method: str, *params: Any) -> Any:
        """Call one method and return its value; raises `RefusedError` for a code other than 1 and for a fault."""
        code, message, value = _triple(self._post(xmlrpc.client.dumps(params, method, allow_none=False)))
        if code != 1:
            raise RefusedError(message)
        return value

    def calls(self, calls: Sequence[Call]) -> list[Any]:
        """Make many calls in one request; return the value of each, None for a failed call.

        If request and response equal the previous ones, the same list object is returned without parsing.
        """
        if self._asked[0] != calls:
            batch = [{"methodName": name, "params": list(params)} for name, params in calls]
            self._asked = (list(calls), xmlrpc.client.dumps((batch,), "system.multicall"))
        answers = self._post(self._asked[1])
        if isinstance(answers, _Answers):
            return answers
        if not isinstance(answers, list) or len(answers) != len(calls):
            raise Ros1ProtocolError(f"{self.uri} does not answer system.multicall with {len(calls)} answers")
        values = _Answers()
        for answer in answers:
            try:
                code, _, value = _triple(answer[0])
            except (LookupError, TypeError, Ros1ProtocolError):
                code, value = 0, None
            values.append(value if code == 1 else None)
        if self._last is not None:
            self._last = (self._last[0], self._last[1], values)
        return values

    def close(self) -> None:
        self._http.close()

    def _post(self, request: str) -> Any:
        body = request.encode()
        deadline = time.monotonic() + self._timeout
        kept = self._http.sock is not None
        try:
            try:
                answer = self._exchange(body, deadline)
            except (http.client.HTTPException, ConnectionError):
                # retry once if the server has closed the persistent connection in the meantime
                if not kept:
                    raise
                self._http.close()
                answer = self._exchange(body, deadline)
        except (OSError, ValueError, http.client.HTTPException) as err:  # ValueError: a chunk of negative length
            self._http.close()
            message = f"{self.uri} does not answer"
            if isinstance(err, OSError) and not isinstance(err, http.client.HTTPException):
                raise unanswered(message, err) from None
            raise Ros1ProtocolError(f"{message}: {str(err) or type(err).__name__}") from None
        if self._last is not None and self._last[0] == body and self._last[1] == answer:
            return self._last[2]
        value = self._parse(answer)
        self._last = (body, answer, value)
        return value

    def _exchange(self, body: bytes, deadline: float) -> bytes:
        self._http.deadline = deadline
        if isinstance(self._http.sock, DeadlineSocket):
            self._http.sock.deadline = deadline
        self._http.request("POST", self._path, body, {"Content-Type": "text/xml"})
        response = self._http.getresponse()
        answer = bytearray()
        # read in pieces, so that a server that only announces a long response costs no memory
        while piece := response.read(_PIECE):
            answer += piece
            if len(answer) > self._limit:
                raise http.client.HTTPException(f"answer longer than {self._limit} bytes")
        if response.length:
            raise http.client.IncompleteRead(bytes(answer[:80]), response.length)
        if response.status != http.client.OK:
            raise http.client.HTTPException(f"HTTP status {response.status}")
        return bytes(answer)

    def _parse(self, answer: bytes) -> Any:
        try:
            return decode_response(answer)
        except xmlrpc.client.Fault as err:
            raise RefusedError(str(err.faultString)) from None
        except ValueError as err:
            raise Ros1ProtocolError(f"{self.uri} does not respond with XML-RPC: {err}") from None


class _Answers(list[Any]):
    """Parsed results of `XmlRpcClient.calls`."""


def ask(uri: str, timeout: float, method: str, *params: Any) -> Any:
    """Call one method of a node on a new connection; see `XmlRpcClient.call`."""
    client = XmlRpcClient(uri, timeout, MAX_NODE_ANSWER)
    with contextlib.closing(client):
        return client.call(method, *params)


def _triple(answer: Any) -> tuple[int, str, Any]:
    if isinstance(answer, list) and len(answer) == 3 and isinstance(answer[0], int):
        return answer[0], str(answer[1]), answer[2]
    raise Ros1ProtocolError(f"not a ROS 1 answer: {str(answer)[:200]}")
