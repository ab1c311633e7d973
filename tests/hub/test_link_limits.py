"""Links to other machines have a TCP time limit, and links within this machine have none."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import psutil
import pytest
import zenoh

from bridge.hub import links
from bridge.hub.links import LinkLimits, limit_links
from bridge.hub.zenoh_config import LEASE_MS
from tests.support.wait import until


@pytest.fixture
def link() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as link:
        yield link


def limit(link: socket.socket) -> int:
    return link.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)


def test_tcp_closes_dead_links_to_other_machines(link: socket.socket) -> None:
    limit_links(psutil.Process(), far=lambda address: address == "127.0.0.1")
    assert limit(link) == LEASE_MS
    link.sendall(b"it is still open")


def test_local_links_are_unchanged(link: socket.socket) -> None:
    limit_links(psutil.Process())
    assert limit(link) == 0


def test_a_closing_session_is_no_trouble(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(links, "_EVERY", 0.01)
    closing = threading.Event()

    def check() -> None:
        raise zenoh.ZError("session closed") if closing.is_set() else RuntimeError

    limits = LinkLimits(check)
    try:
        until(lambda: limits.trouble, "the check fails")
        closing.set()
        until(lambda: not limits.trouble, "the trouble ends with the session")
    finally:
        limits.close()


def test_links_are_checked_again_after_an_error(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(links, "_EVERY", 0.01)
    works = threading.Event()
    checks: list[int] = []

    def check() -> None:
        checks.append(len(checks))
        if not works.is_set():
            msg = "can't start new thread"
            raise RuntimeError(msg)

    limits = LinkLimits(check)
    try:
        until(lambda: len(checks) > 5, "the links are checked again")
        assert limits.trouble == "checking the links to other machines failed: RuntimeError: can't start new thread"
        assert [record.name for record in caplog.records].count(links.__name__) == 1, "one traceback a minute"
        works.set()
        until(lambda: not limits.trouble, "the checks work again")
    finally:
        limits.close()
