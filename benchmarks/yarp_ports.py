"""YARP ports compared with bare sockets that move the same bytes: RPC and streams over tcp and fast_tcp on loopback.

Both use two processes. The bare sockets know how many bytes to expect, and inspect none of them; the ports parse the
messages. Their rounds take turns. Each figure is the median over the rounds: of a round's median round trip, or of a
stream's time per message, from the first byte sent until the other process has received the last byte.

The choice of cores matters more than the code. On one core a bare round trip took 13 microseconds, on two cores of the
same virtual machine 56, because each end sleeps until the other core wakes it. The system may place each pair
of processes in either way, so both placements are measured.
"""

from __future__ import annotations

import argparse
import os
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.port import PortCore
from yarp_compat.wire import framing
from yarp_compat.wire.binary import encode
from yarp_compat.wire.profile import Profile

_EMPTY = encode([], Profile.YARP3)
_NUMBERS = encode([i + 0.5 for i in range(10)], Profile.YARP3)
_VECTOR = encode([float(i) for i in range(1000)], Profile.YARP3)
_IMAGE = bytes(60) + bytes(range(256)) * (640 * 480 * 3 // 256)
_BARRIER = framing.prefix(len(_EMPTY), "d") + _EMPTY
_REQUESTS = 1000
_PLACES = {"one": ", one core", "two": ", two cores", "any": ""}
"""Placement of both processes, with its text in the rows; ``any``: chosen by the system."""


@dataclass(frozen=True, slots=True)
class Stream:
    """The stream of one round: the messages' name, content and number."""

    name: str
    payload: bytes
    count: int


_STREAMS = (
    Stream("Bottle of 10 numbers", _NUMBERS, 2000),
    Stream("Vector of 1000", _VECTOR, 1000),
    Stream("Image 640x480", _IMAGE, 60),
)


# -- the other process ------------------------------------------------------------------------------------------------


def _serve_port() -> None:
    """Run a port that echoes RPC requests, until standard input ends."""

    def answer(incoming: PortMessage) -> None:
        if incoming.wants_reply:
            incoming.reply(bytes(incoming.payload))

    port = PortCore("/peer", on_message=answer, naming=LocalNaming())
    print(port.open().port, flush=True)
    sys.stdin.read()
    port.close()


def _serve_bare() -> None:
    """Run a socket that exchanges bytes as each input line says: size of a request, repetitions, size of a reply."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        print(server.getsockname()[1], flush=True)
        sock, _ = server.accept()
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    memory = bytearray(1 << 20)
    for line in sys.stdin:
        size, times, reply = map(int, line.split())
        answer = bytes(reply)
        for _ in range(times):
            left = size
            while left:
                left -= sock.recv_into(memory, min(left, len(memory)))
            if reply:
                sock.sendall(answer)
    sock.close()


def _places() -> list[str]:
    """Return the placements to measure: one core and two cores, or any if the system supports no choice."""
    can_choose = hasattr(os, "sched_setaffinity") and len(os.sched_getaffinity(0)) > 1
    return ["one", "two"] if can_choose else ["any"]


@contextmanager
def _placed(cores: set[int] | None) -> Iterator[None]:
    """Run on these cores, including threads and processes that are started in the context."""
    if cores is None:
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def _process(role: str, cores: set[int] | None) -> Iterator[tuple[subprocess.Popen[str], int]]:
    command = [sys.executable, __file__, "--serve", role]
    with _placed(cores):
        started = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with started as process:
        assert process.stdout is not None
        assert process.stdin is not None
        try:
            yield process, int(process.stdout.readline())
        finally:
            process.stdin.close()


# -- this process -----------------------------------------------------------------------------------------------------


class Ours:
    """A port that is connected to the port of the other process."""

    def __init__(self, number: int, carrier: str) -> None:
        naming = LocalNaming()
        naming.register("/peer", "127.0.0.1", number)
        self._port = PortCore("/bench", naming=naming)
        self._port.open()
        done, reason = self._port.add_output(f"{carrier}://peer")
        assert done, reason

    def round_trips(self, count: int) -> float:
        """Return the median round trip, in microseconds."""
        return _median(lambda: self._port.request(_NUMBERS, timeout=5), count)

    def stream(self, stream: Stream, count: int) -> float:
        """Return the microseconds per message of a stream."""
        start = time.perf_counter()
        for _ in range(count):
            self._port.write(stream.payload, wait=True)
        self._port.request(_EMPTY, timeout=5)
        return (time.perf_counter() - start) / count * 1e6

    def close(self) -> None:
        self._port.close()


class Bare:
    """A socket that is connected to the socket of the other process, and moves the same bytes."""

    def __init__(self, process: subprocess.Popen[str], number: int, carrier: str) -> None:
        self._process = process
        self._sock = socket.create_connection(("127.0.0.1", number))
        self._sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._ack = len(framing.ACK) if carrier == "tcp" else 0

    def _expect(self, size: int, times: int, reply: int) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{size} {times} {reply}\n")
        self._process.stdin.flush()

    def _call(self, request: bytes, reply: int) -> None:
        self._sock.sendall(request)
        while reply:
            reply -= len(self._sock.recv(reply))

    def round_trips(self, count: int) -> float:
        """Return the median round trip, in microseconds."""
        request, reply = framing.prefix(len(_NUMBERS), "d") + _NUMBERS, len(_NUMBERS) + self._ack
        self._expect(len(request), count, reply)
        return _median(lambda: self._call(request, reply), count)

    def stream(self, stream: Stream, count: int) -> float:
        """Return the microseconds per message of a stream."""
        sent = framing.prefix(len(stream.payload)) + stream.payload
        self._expect(len(sent), count, self._ack)
        self._expect(len(_BARRIER), 1, len(_EMPTY) + self._ack)
        start = time.perf_counter()
        for _ in range(count):
            self._call(sent, self._ack)
        self._call(_BARRIER, len(_EMPTY) + self._ack)
        return (time.perf_counter() - start) / count * 1e6

    def close(self) -> None:
        self._sock.close()


def _median(call: Callable[[], object], times: int) -> float:
    durations = []
    for _ in range(times):
        start = time.perf_counter()
        call()
        durations.append(time.perf_counter() - start)
    return statistics.median(durations) * 1e6


def _cores(place: str) -> tuple[set[int] | None, set[int] | None]:
    """Return the cores of this process and of the other."""
    if place == "any":
        return None, None
    mine = sorted(os.sched_getaffinity(0))
    return {mine[0]}, {mine[-1 if place == "two" else 0]}


def _rows(carrier: str, place: str, rounds: int, share: float) -> list[Row]:
    own_cores, peer_cores = _cores(place)
    with (
        _process("port", peer_cores) as (_, ours_at),
        _process("bare", peer_cores) as (process, bare_at),
        _placed(own_cores),
    ):
        ours, bare = Ours(ours_at, carrier), Bare(process, bare_at, carrier)

        def both(stream: Stream | None) -> tuple[float, float]:
            count = max(2, round((stream.count if stream else _REQUESTS) * share))
            if stream is None:
                return ours.round_trips(count), bare.round_trips(count)
            return ours.stream(stream, count), bare.stream(stream, count)

        rows = []
        for stream in (None, *_STREAMS):
            figures = [both(stream) for _ in range(rounds)]
            mine, theirs = (statistics.median(column) for column in zip(*figures, strict=True))
            name = stream.name if stream else "RPC of 10 numbers"
            rows.append(Row(f"{name}, {carrier}{_PLACES[place]}", mine, theirs, "us"))
        ours.close()
        bare.close()
        return rows


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--share", type=float, default=1.0, help="share of a round's messages; below 1 is faster")
    parser.add_argument("--cores", choices=_PLACES, nargs="+", help="placements of both processes (default: one two)")
    parser.add_argument("--serve", choices=["port", "bare"], help=argparse.SUPPRESS)
    add_json_option(parser)
    options = parser.parse_args(arguments)
    if options.serve == "port":
        _serve_port()
    elif options.serve == "bare":
        _serve_bare()
    else:
        cases = [(carrier, place) for place in options.cores or _places() for carrier in ("tcp", "fast_tcp")]
        report([row for case in cases for row in _rows(*case, options.rounds, options.share)], options.json)


if __name__ == "__main__":
    main()
