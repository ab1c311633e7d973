"""A console worker in a separate process, on a real hub, and clients that send it arbitrary data."""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import json
import math
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import psutil
import yaml

from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.json import to_json
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.peers.hub.quick import QuickHub
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.ports.sockets import closed_on_failure

TWIST = "geometry_msgs/msg/Twist"
SPEED, TURN = 0.3, 0.6
MOST_GROWTH = 32 << 20
"""Allowed growth in bytes after the warm-up. Measured: 14 MB over 135,000 requests and frames, 18 MB over 426,000.
Cyclic garbage waits for Python's collector, and growth by any one kind of request stops after a few thousand."""

_WARM = 1000
_LOOK = 200
_ANSWERS = {100, 101, 200, 206, 304, 307, 400, 403, 404, 405, 413, 416, 426, 431, 503}
_OPS = {"hello", "value", "reply", "held", "error"}
_LATER_NS = 3_000_000_000
"""Nanoseconds after a page's last hold in which the base may still be commanded to move: 0.3 s, plus the time that a
console on a busy machine takes to read what a closed page has sent."""


class HostileConsole:
    """Sends invalid data to the console, and checks the consequences.

    Attributes:
        hubs: the console's hub.
        sent: number of requests and frames.
        drove: number of velocities other than zero that were received.
    """

    def __init__(self, folder: Path) -> None:
        self.hubs = QuickHub()
        self.port = free_port()
        self.host = f"127.0.0.1:{self.port}"
        self._log = folder / "console.log"
        file = folder / "midspan.yaml"
        config = {
            "name": "hostile",
            "state": str(folder / "state"),
            "hub": {"listen": self.hubs.endpoint},
            "navigation": {"planner": "nav2"},
            "web": {"enabled": True, "listen": self.host, "speed": SPEED, "turn": TURN},
        }
        file.write_text(yaml.safe_dump(config))
        self._registry = Registry()
        self._far = HubSide(Hub.open(self.hubs.settings("far")), self._registry)
        for name in ("stop", "pause", "resume"):
            self._far.serve(f"/navigation/{name}", "std_srvs/Trigger", reply={"success": True, "message": name})
        self._may_drive = 0.0
        self._wrong = ""
        self.sent = self.drove = 0
        kind = self._registry.ros2(TWIST).type_id
        self._far.hub.subscription("/cmd_vel", TWIST, kind, Qos(depth=100), self._on_velocity)
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "bridge.cli.main", "worker", "web", "--config", str(file)],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=Path(__file__).parents[3],
                preexec_fn=_end_with_parent,
            )  # fmt: skip
        self._console = psutil.Process(self._process.pid)
        self._warm_bytes = 0
        self._numbers = itertools.count(1)
        with closed_on_failure(self):
            until(self._answers, "the console responds", 60)

    def _answers(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 5):
            return True
        return False

    def _on_velocity(self, sample: Any) -> None:
        content = to_json(self._registry, TWIST, sample.data())
        velocity = [*content["linear"].values(), *content["angular"].values()]
        if not any(velocity):
            return
        self.drove += 1
        if sample.source_time_ns > self._may_drive:
            self._wrong = f"the base is driven although no page holds: {velocity}"
        elif max(map(abs, velocity[:3])) > SPEED or max(map(abs, velocity[3:])) > TURN:
            self._wrong = f"the base is driven too fast: {velocity}"

    # -- HTTP ----------------------------------------------------------------------------------------------------------

    def ask(self, requests: Sequence[bytes]) -> None:
        """Send each request on a separate connection, all at once; each must get a valid response or be closed."""
        open_ = [socket.create_connection(("127.0.0.1", self.port), 10) for _ in requests]
        received = dict.fromkeys(open_, b"")
        try:
            for sock, request in zip(open_, requests, strict=True):
                with contextlib.suppress(OSError):
                    sock.sendall(request)
            left = set(open_)
            while left and (ready := select.select(left, [], [], 0.004)[0]):
                left -= {sock for sock in ready if not _more(sock, received)}
            for sock in left:  # the request is unfinished, and nothing more is sent
                with contextlib.suppress(OSError):
                    sock.shutdown(socket.SHUT_WR)
            end = time.monotonic() + 20.0
            while left:
                assert time.monotonic() < end, "the console keeps a connection whose other end has closed"
                left -= {sock for sock in select.select(left, [], [], 1.0)[0] if not _more(sock, received)}
        finally:
            for sock in open_:
                sock.close()
        for sock, request in zip(open_, requests, strict=True):
            self._judge(request, received[sock])
        self._after(len(requests))

    def _judge(self, request: bytes, answer: bytes) -> None:
        if not answer:
            return
        head, _, _ = answer.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 "), answer[:80]
        status = int(head[9:12])
        assert status in _ANSWERS, (status, request[:200])
        if self.host.encode() not in request and b"localhost:%d" % self.port not in request.lower():
            assert status >= 400, (status, request[:200])
        if status in (200, 403, 404) and b"upgrade" not in request.lower():
            assert b"content-security-policy" in head, (status, request[:200])

    # -- WebSocket -----------------------------------------------------------------------------------------------------

    def converse(self, pieces: Sequence[bytes]) -> None:
        """Open a WebSocket as a page does, and send frames; the first byte of a piece is its kind, as in `_frames`."""
        with socket.create_connection(("127.0.0.1", self.port), 10) as sock:
            sock.sendall(opening(self.host))
            received = _Frames(sock)
            head = received.head()
            if not head.startswith(b"HTTP/1.1 101 "):
                assert int(head[9:12]) == 503, head[:200]
                return
            whole = True
            try:
                for piece in pieces:
                    kind, content = piece[:1], piece[1:]
                    if _holds(kind, content):
                        self._may_drive = math.inf
                    whole &= kind != b"r"
                    sock.sendall(_frames(kind, content))
                sock.sendall(client_frame(9, b"the end"))
                received.until_pong(b"the end", 10.0 if whole else 0.02)
            except OSError:
                pass  # the console has closed the connection
        if self._may_drive == math.inf:
            self._may_drive = time.time_ns() + _LATER_NS
        self._after(1 + sum(piece[1] if piece[:1] == b"m" and len(piece) > 1 else 1 for piece in pieces))

    # -- consequences --------------------------------------------------------------------------------------------------

    def _after(self, sent: int) -> None:
        self.sent += sent
        if next(self._numbers) % _LOOK == 0:
            self.check()

    def check(self) -> None:
        """Raise `AssertionError` if the worker has ended, driven, grown too much, or logged an unexpected error."""
        assert self._process.poll() is None, f"the worker has ended: {self.log()[-3000:]}"
        wrong, self._wrong = self._wrong, ""
        assert not wrong, wrong
        at = self.log().find("Traceback")
        assert at < 0, self.log()[max(at - 500, 0) : at + 4000]
        used = self._console.memory_info().rss
        if self.sent >= _WARM:
            self._warm_bytes = self._warm_bytes or used
            growth = used - self._warm_bytes
            assert growth <= MOST_GROWTH, f"the worker grew by {growth >> 20} MB over {self.sent} requests and frames"

    @property
    def growth(self) -> int:
        """Return the growth of the worker since the warm-up, in bytes."""
        return int(self._console.memory_info().rss) - self._warm_bytes

    def log(self) -> str:
        """Return the worker's output."""
        return self._log.read_text(errors="replace")

    def close(self) -> None:
        """End the worker."""
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._far.hub.close()
        self.hubs.stop_router()


def opening(host: str) -> bytes:
    """Return the request that opens a page's socket."""
    return (
        f"GET /socket HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        "Sec-WebSocket-Protocol: midspan.console.1\r\n\r\n"
    ).encode()


def _end_with_parent() -> None:
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def _more(sock: socket.socket, received: dict[socket.socket, bytes]) -> bool:
    """Read once, and return whether more may arrive."""
    try:
        data = sock.recv(1 << 16)
    except OSError:
        return False
    received[sock] = (received[sock] + data)[:4096]
    return bool(data)


def client_frame(opcode: int, content: bytes, *, fin: bool = True) -> bytes:
    """Return a client's frame, masked with zeros (RFC 6455, section 5.2)."""
    size = len(content)
    head = bytes([(0x80 if fin else 0) | opcode])
    if size < 126:
        head += bytes([0x80 | size])
    elif size < 1 << 16:
        head += b"\xfe" + struct.pack(">H", size)
    else:
        head += b"\xff" + struct.pack(">Q", size)
    return head + bytes(4) + content


def _frames(kind: bytes, content: bytes) -> bytes:
    match kind:
        case b"r":
            return content
        case b"m":  # many
            return client_frame(1, content[1:]) * (content[0] if content else 1)
        case b"s":
            return client_frame(1, content, fin=False)
        case b"n":
            return client_frame(0, content, fin=False)
        case b"e":
            return client_frame(0, content)
        case b"b":
            return client_frame(2, content)
        case b"p":
            return client_frame(9, content[:125])
        case b"o":
            return client_frame(10, content[:125])
        case b"c":
            return client_frame(8, content[:125])
        case _:
            return client_frame(1, content)


def _holds(kind: bytes, content: bytes) -> bool:
    """Return whether a piece may be a valid hold; parts of messages may combine into a hold."""
    if kind in (b"s", b"n", b"e", b"r"):
        return True
    try:
        message = json.loads(content[1:] if kind == b"m" else content)
    except (ValueError, RecursionError):
        return False
    return isinstance(message, dict) and message.get("op") == "hold"


class _Frames:
    """The console's frames on a socket."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock, self._left = sock, b""

    def _read(self, end: float) -> bool:
        if not select.select([self._sock], [], [], max(end - time.monotonic(), 0.0))[0]:
            return False
        data = self._sock.recv(1 << 16)
        self._left += data
        return bool(data)

    def head(self) -> bytes:
        """Return the response to the opening request."""
        end = time.monotonic() + 20.0
        while b"\r\n\r\n" not in self._left:
            assert self._read(end), f"the console does not respond to an opening request: {self._left!r}"
        head, _, self._left = self._left.partition(b"\r\n\r\n")
        return head

    def until_pong(self, content: bytes, seconds: float) -> None:
        """Read until this pong, a close frame or the end; each text must be a JSON message with a known ``op``."""
        end = time.monotonic() + seconds
        while True:
            while (frame := self._next()) is not None:
                opcode, text = frame
                if opcode == 1:
                    message = json.loads(text)
                    assert message["op"] in _OPS, message
                elif opcode == 8 or (opcode == 10 and text == content):
                    return
            if not self._read(end):
                waited = time.monotonic() > end
                assert not waited or seconds < 1.0, "the console does not reply to a ping"
                return

    def _next(self) -> tuple[int, bytes] | None:
        """Return the next complete frame. The console's frames are not masked."""
        if len(self._left) < 2:
            return None
        size, at = self._left[1] & 0x7F, 2
        if size >= 126:
            at = 4 if size == 126 else 10
            if len(self._left) < at:
                return None
            size = int.from_bytes(self._left[2:at], "big")
        if len(self._left) < at + size:
            return None
        opcode, content = self._left[0] & 0x0F, self._left[at : at + size]
        self._left = self._left[at + size :]
        return opcode, content
