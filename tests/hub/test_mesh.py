"""Two sessions whose direct link alone is cut are linked again; those that end are not missed."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator

import psutil
import pytest

from bridge.hub import mesh
from bridge.hub.session import Hub
from tests.support.quick_hub import QuickHub
from tests.support.wait import until


@pytest.fixture
def hubs() -> Iterator[QuickHub]:
    with QuickHub() as network:
        yield network


def peers(hub: Hub) -> set[str]:
    return {str(zid) for zid in hub._session.info.peers_zid()}


def cut(port: int) -> None:
    """Cut the links between peers: connections of this process where neither end is the router's port."""
    mine = psutil.Process().net_connections("tcp")
    listening = {c.laddr.port for c in mine if c.status == psutil.CONN_LISTEN} - {port}
    between = [c for c in mine if c.status == psutil.CONN_ESTABLISHED and c.laddr.port in listening]
    assert between
    for connection in between:
        with contextlib.closing(socket.socket(fileno=os.dup(connection.fd))) as end:
            end.shutdown(socket.SHUT_RDWR)


def test_a_link_that_alone_was_cut_is_made_again(hubs: QuickHub) -> None:
    with Hub.open(hubs.settings("one")) as one, Hub.open(hubs.settings("two", "two")) as two:
        until(lambda: two.zid in peers(one) and one.zid in peers(two), "they are linked")
        heard: list[bytes] = []
        router = str(hubs._session.info.zid())
        hubs._control.serve(mesh.MEMBERS, lambda _: {"zid": router, "members": 5})  # a liar is not believed
        two.serve("say", lambda params: heard.append(params["word"]))
        cut(int(hubs.endpoint.rpartition(":")[2]))
        until(lambda: two.zid not in peers(one) or one._mesh.mended + two._mesh.mended, "the link is lost")
        until(lambda: two.zid in peers(one) and one.zid in peers(two), "they are linked again")
        until(lambda: one._mesh.mended + two._mesh.mended, "who mended it knows")
        until(lambda: one.ask("say", {"word": "again"}, worker="two") and heard, "they hear each other")


def test_who_left_is_not_missed(hubs: QuickHub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh, "_REMEMBERED_SECONDS", 1.0)
    with Hub.open(hubs.settings("one")) as one:
        with Hub.open(hubs.settings("two", "two")) as two:
            until(lambda: two.zid in peers(one), "they are linked")
        until(lambda: two.zid not in peers(one), "the link's end is known")
        until(lambda: not one._mesh._lost, "nobody is looked for any more")
        assert not one._mesh.mended


def test_a_session_may_be_closed_before_its_thread_watches(hubs: QuickHub) -> None:
    hub = Hub.open(hubs.settings("one"))
    hub.close()
    hub._mesh._run()
