"""Connections to hosts with several addresses."""

from __future__ import annotations

import errno
import itertools
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from types import SimpleNamespace

import pytest

from yarp_compat.ports import sockets


@pytest.fixture
def two_addresses(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[socket.socket, socket.socket]]:
    """Two listening sockets of one host; the first one's backlog is full, so that it ignores connections."""
    with ExitStack() as stack:
        silent = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
        for _ in range(4):
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(silent.getsockname())
        other = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        entries = [(socket.AF_INET, socket.SOCK_STREAM, 0, "", sock.getsockname()) for sock in (silent, other)]
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: entries)
        yield silent, other


def test_address_that_does_not_answer_leaves_time_for_the_next(
    two_addresses: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    times = itertools.count(0.0, 0.05)  # a clock that stands still together with this process
    monkeypatch.setattr(sockets, "time", SimpleNamespace(monotonic=lambda: next(times)))
    end = 3.0
    with sockets.open_connection("robot", 1, lambda: end) as sock:
        assert sock.getpeername() == two_addresses[1].getsockname()
        assert 0.0 < (sock.gettimeout() or 0.0) <= 1.5


def test_timeout_of_the_kernel_does_not_prevent_the_next_address(
    two_addresses: tuple[socket.socket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    class TimedOut(socket.socket):
        """A socket whose connections to the first address end with the kernel's timeout."""

        def connect_ex(self, address: object) -> int:
            silent = address == two_addresses[0].getsockname()
            return errno.ETIMEDOUT if silent else super().connect_ex(address)  # type: ignore[arg-type]

    monkeypatch.setattr(socket, "socket", TimedOut)
    end = time.monotonic() + 60.0
    with sockets.open_connection("robot", 1, lambda: end) as sock:
        assert sock.getpeername() == two_addresses[1].getsockname()


def test_connection_that_is_made_while_this_process_is_suspended_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    end = time.monotonic() + 60.0

    class Suspended(socket.socket):
        """A socket whose process is suspended beyond the deadline while it connects."""

        def connect_ex(self, address: object) -> int:
            nonlocal end
            result = super().connect_ex(address)  # type: ignore[arg-type]
            end = time.monotonic() - 1.0
            return result

    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr(socket, "socket", Suspended)
        with sockets.open_connection("127.0.0.1", server.getsockname()[1], lambda: end) as sock:
            assert sock.getpeername() == server.getsockname()
