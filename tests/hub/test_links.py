"""Sessions restore missing direct links between them, and stop looking for sessions that have ended."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Collection, Iterator
from typing import Any

import psutil
import pytest
import zenoh

from bridge.hub import links
from bridge.hub.errors import HubConfigError
from bridge.hub.node import Hub
from tests.peers.hub.network import HubNetwork
from tests.peers.hub.quick import QuickHub
from tests.support.recorded_waits import recorded_waits
from tests.support.wait import until


@pytest.fixture
def hubs() -> Iterator[QuickHub]:
    with QuickHub() as network:
        yield network


def cut(port: int) -> None:
    """Cut the links between peers: this process's connections that do not use the router's port at either end."""
    mine = psutil.Process().net_connections("tcp")
    listening = {c.laddr.port for c in mine if c.status == psutil.CONN_LISTEN} - {port}
    between = [c for c in mine if c.status == psutil.CONN_ESTABLISHED and c.laddr.port in listening]
    assert between
    for connection in between:
        with contextlib.closing(socket.socket(fileno=os.dup(connection.fd))) as end:
            end.shutdown(socket.SHUT_RDWR)


def test_single_lost_link_is_restored(hubs: QuickHub) -> None:
    with Hub.open(hubs.settings("one")) as first, Hub.open(hubs.settings("two", "two")) as second:
        until(lambda: second.zid in first.neighbors() and first.zid in second.neighbors(), "the sessions are linked")
        received: list[bytes] = []
        hubs.serve_conflicting_list(5)  # conflicting lists are not trusted
        second.serve("say", lambda params: received.append(params["word"]))
        cut(int(hubs.endpoint.rpartition(":")[2]))
        until(lambda: second.zid not in first.neighbors() or first.mesh.mended + second.mesh.mended, "the link is lost")
        until(
            lambda: second.zid in first.neighbors() and first.zid in second.neighbors(), "the sessions are linked again"
        )
        until(lambda: first.mesh.mended + second.mesh.mended, "one session reports the restored link")
        until(lambda: first.ask("say", {"word": "again"}, worker="two") and received, "messages arrive")


def test_lost_link_is_noticed_without_polling(hubs: QuickHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """The graph reports it: the tokens of the other session end with the link. Polling would cost an idle process."""
    wake, pauses = recorded_waits()
    monkeypatch.setattr(links, "_COMPARE_SECONDS", 1000.0)
    monkeypatch.setattr(links, "Event", wake)
    with Hub.open(hubs.settings("one")) as first, Hub.open(hubs.settings("two", "two")) as second:
        until(lambda: second.zid in first.neighbors() and first.zid in second.neighbors(), "the sessions are linked")
        until(lambda: pauses and (pauses[-1] or 0.0) > 900.0, "the sessions sleep")
        cut(int(hubs.endpoint.rpartition(":")[2]))
        until(lambda: first.mesh.mended + second.mesh.mended, "one session has restored the link")
        until(lambda: second.zid in first.neighbors(), "the sessions are linked again")


def test_link_in_another_domain_than_the_routers_is_restored() -> None:
    with HubNetwork() as hubs:
        hubs.domain = 7
        with Hub.open(hubs.settings("one")) as first, Hub.open(hubs.settings("two", "two")) as second:
            until(
                lambda: second.zid in first.neighbors() and first.zid in second.neighbors(), "the sessions are linked"
            )
            cut(int(hubs.endpoint.rpartition(":")[2]))
            until(lambda: first.mesh.mended + second.mesh.mended, "one session has restored the link")
            until(lambda: second.zid in first.neighbors(), "the sessions are linked again")


def test_missing_link_is_established(hubs: QuickHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """The session compares its links with the router's peers, even if no event reports the missing link."""
    monkeypatch.setattr(links, "_COMPARE_SECONDS", 0.3)
    monkeypatch.setattr(links.Mesh, "_on_event", lambda *_: None)
    with Hub.open(hubs.settings("one")) as first, Hub.open(hubs.settings("two", "two")) as second:
        until(lambda: second.zid in first.neighbors() and first.zid in second.neighbors(), "the sessions are linked")
        cut(int(hubs.endpoint.rpartition(":")[2]))
        until(
            lambda: second.zid not in first.neighbors() or first.mesh.mended + second.mesh.mended,
            "the link is lost",
        )
        until(lambda: first.mesh.mended + second.mesh.mended, "one session has restored the link")
        until(
            lambda: second.zid in first.neighbors() and first.zid in second.neighbors(), "the sessions are linked again"
        )


def test_links_are_compared_during_the_search_for_a_closed_session(
    hubs: QuickHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise, the short sessions of command-line programs would keep a session from noticing a missing link."""
    monkeypatch.setattr(links, "_COMPARE_SECONDS", 0.2)
    with Hub.open(hubs.settings("one")) as first:
        with Hub.open(hubs.settings("two", "two")) as second:
            until(lambda: second.zid in first.neighbors(), "the sessions are linked")
            left = second.zid
        until(lambda: left in first.mesh.lost, "the closed session is searched for")
        hubs.list_also("abcd")
        until(lambda: "abcd" in first.mesh.lost, "the links are compared", 30)
        assert left in first.mesh.lost


@contextlib.contextmanager
def given_up(hubs: QuickHub, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    """Open a session that has given up the search for an unreachable one."""
    monkeypatch.setattr(links, "_COMPARE_SECONDS", 0.2)
    monkeypatch.setattr(links, "_REMEMBERED_SECONDS", 0.5)
    with Hub.open(hubs.settings("one")) as hub:
        hubs.list_also("abcd")
        until(lambda: "abcd" in hub.mesh._unreachable and not hub.mesh.lost, "the search for the session has ended")
        yield hub


def test_search_for_an_unreachable_session_ends(hubs: QuickHub, monkeypatch: pytest.MonkeyPatch) -> None:
    with given_up(hubs, monkeypatch) as hub:
        answered = hubs.answered
        until(lambda: hubs.answered > answered + 3, "the links are compared again")
        assert not hub.mesh.lost


def test_a_query_without_an_answer_does_not_begin_another_search(
    hubs: QuickHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In another search, the router's link to the session would be ended again."""
    with given_up(hubs, monkeypatch) as hub:
        hubs.unanswered = 1
        until(lambda: not hubs.unanswered, "a query is not answered")
        answered = hubs.answered
        until(lambda: hubs.answered > answered + 4 or hub.mesh.lost, "the links are compared again")
        assert not hub.mesh.lost


def test_an_unreachable_session_is_searched_for_again(hubs: QuickHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """What kept it from linking may be over while the router still lists it. It is asked to rejoin only once."""
    monkeypatch.setattr(links, "_COMPARE_SECONDS", 0.2)
    monkeypatch.setattr(links, "_REMEMBERED_SECONDS", 3.0)
    monkeypatch.setattr(links, "_HOPELESS_SECONDS", 0.0)
    monkeypatch.setattr(links, "_INTRODUCTION_SECONDS", 0.1)
    monkeypatch.setattr(links, "_SEARCH_AGAIN_SECONDS", 0.5)
    asked, introduced = list[Collection[str]](), list[Collection[str]]()
    introduce = links.Mesh._introduce

    def count(mesh: links.Mesh, missing: Collection[str]) -> bool:
        introduced.append(missing)
        return introduce(mesh, missing)

    monkeypatch.setattr(links.Mesh, "_introduce", count)
    with Hub.open(hubs.settings("one")) as hub:
        monkeypatch.setattr(hub.mesh, "_rejoin", asked.append)
        hubs.list_also("abcd")
        until(lambda: "abcd" in hub.mesh.lost, "the unreachable session is searched for", 30)
        until(lambda: not hub.mesh.lost, "the search ends")
        assert asked, "the session is asked to rejoin"
        asked.clear()
        introduced.clear()
        until(lambda: introduced, "the unreachable session is searched for again", 30)
        until(lambda: not hub.mesh.lost, "the search ends again")
        assert not asked


def test_router_without_a_response_is_queried_again(hubs: QuickHub) -> None:
    with Hub.open(hubs.settings("one")) as first, Hub.open(hubs.settings("two", "two")) as second:
        until(lambda: second.zid in first.neighbors() and first.zid in second.neighbors(), "the sessions are linked")
        hubs.unanswered = 4
        cut(int(hubs.endpoint.rpartition(":")[2]))
        until(lambda: first.mesh.mended + second.mesh.mended, "the link is restored")
        assert not hubs.unanswered


def test_search_for_a_closed_session_ends(hubs: QuickHub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(links, "_REMEMBERED_SECONDS", 1.0)
    with Hub.open(hubs.settings("one")) as first:
        with Hub.open(hubs.settings("two", "two")) as second:
            until(lambda: second.zid in first.neighbors(), "the sessions are linked")
        until(lambda: second.zid not in first.neighbors(), "the end of the link is noticed")
        until(lambda: not first.mesh.lost, "the search has ended")
        assert not first.mesh.mended


class LateThread(threading.Thread):
    """A thread that starts when it is joined."""

    def start(self) -> None:
        """Do nothing until `join`."""

    def join(self, timeout: float | None = None) -> None:
        super().start()
        super().join(timeout)


def test_session_may_close_before_its_mesh_thread_starts(hubs: QuickHub, monkeypatch: pytest.MonkeyPatch) -> None:
    threads: list[LateThread] = []

    def thread(**options: Any) -> LateThread:
        threads.append(LateThread(**options))
        return threads[-1]

    monkeypatch.setattr(links, "Thread", thread)
    Hub.open(hubs.settings("one")).close()
    assert [mesh_thread.is_alive() for mesh_thread in threads] == [False]


@pytest.mark.parametrize(
    "error", [HubConfigError("hub.zenoh: not JSON5"), zenoh.ZError("timeout"), RuntimeError("can't start new thread")]
)
def test_links_are_compared_again_after_an_error(
    hubs: QuickHub, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """The file of ``hub.zenoh`` may be invalid, and the system short of resources, for a moment."""
    compared = threading.Event()
    errors = [error]

    def compare(_mesh: object) -> None:
        if errors:
            raise errors.pop()
        compared.set()

    monkeypatch.setattr(links.Mesh, "_compare", compare)
    with Hub.open(hubs.settings("one")):
        until(compared.is_set, "the links are compared again")


def test_events_that_cannot_be_read_do_not_keep_the_thread_busy(
    hubs: QuickHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    wake, pauses = recorded_waits()

    def fail(_mesh: object) -> None:
        raise zenoh.ZError("the ringbuffer has been deleted")

    monkeypatch.setattr(links, "Event", wake)
    monkeypatch.setattr(links, "_COMPARE_SECONDS", 0.2)
    monkeypatch.setattr(links.Mesh, "_handle_events", fail)
    with Hub.open(hubs.settings("one")):
        until(lambda: len(pauses) > 10, "the thread has waited several times")
    assert sum(pause == 0.0 for pause in pauses) < 3
