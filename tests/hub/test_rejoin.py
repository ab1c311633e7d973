"""Sessions whose addresses only the router knows are linked again with Midspan's sessions."""

from __future__ import annotations

import json
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from bridge.hub import rejoin
from bridge.hub.graph.tokens import NodeToken, node_key
from bridge.hub.node import Hub
from bridge.hub.rejoin import REJOIN, Rejoins
from bridge.hub.security.link_restart import close_connection
from tests.peers.hub.quick import QuickHub
from tests.peers.zenoh.rmw import CONFIG
from tests.support.wait import until


@pytest.fixture
def hubs() -> Iterator[QuickHub]:
    with QuickHub() as network:
        yield network


def node_of_rmw(hubs: QuickHub, zid: str) -> zenoh.Session:
    """Open the session of an rmw_zenoh node with a given id."""
    return zenoh.open(
        zenoh.Config.from_json5(json.dumps({**CONFIG, "connect": {"endpoints": [hubs.endpoint]}, "id": zid}))
    )


def links(node: zenoh.Session, zid: str) -> list[tuple[str, str]]:
    """Return both addresses of each direct link of the node to another session."""
    return [(str(link.src), str(link.dst)) for link in node.info.links() if str(link.zid) == zid]


def cut(node: zenoh.Session, zid: str) -> None:
    """Cut the node's direct link to another session."""
    assert [close_connection(*ends) for ends in links(node, zid)] == [True]


@pytest.mark.parametrize("digit", ["1", "f"])
def test_the_link_to_a_node_of_rmw_zenoh_is_restored_whichever_end_opens_it(hubs: QuickHub, digit: str) -> None:
    """The session with the greater id opens the link. A node of rmw_zenoh sends its address to routers only."""
    zid = digit * 32
    with Hub.open(hubs.settings("one")) as hub, node_of_rmw(hubs, zid) as node:
        token = node.liveliness().declare_token(node_key(NodeToken(hubs.domain, zid, "0", "/", "controller_server")))
        until(lambda: zid in hub.neighbors() and links(node, hub.zid), "the sessions are linked")
        before = hub.mesh.ended
        cut(node, hub.zid)
        until(lambda: hub.mesh.ended > before, "the link is lost")
        until(lambda: zid in hub.neighbors(), "the sessions are linked again")
        token.undeclare()


def test_pauses_between_the_links_of_a_session_double(monkeypatch: pytest.MonkeyPatch) -> None:
    now, closed = [1000.0], list[str]()
    monkeypatch.setattr(rejoin, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(rejoin, "close_connection", lambda _here, there: closed.append(there) or True)
    links = [SimpleNamespace(zid=zid, src="tcp/127.0.0.1:1", dst=zid) for zid in ("aa", "bb")]
    token = SimpleNamespace(ok=True)
    liveliness = SimpleNamespace(get=lambda key, **_options: iter([token] if key.startswith("@ros2_lv/") else []))
    session: Any = SimpleNamespace(info=SimpleNamespace(links=lambda: links), liveliness=lambda: liveliness)
    rejoins = Rejoins(session)
    assert rejoins.answer({"sessions": ["aa", "cc"]}) == {"sessions": ["aa"]}
    assert rejoins.answer({"sessions": ["aa", "bb"]}) == {"sessions": ["bb"]}
    for seconds, expected in ((4.9, []), (0.2, ["aa"]), (9.8, []), (0.3, ["aa"])):
        now[0] += seconds
        assert rejoins.answer({"sessions": ["aa"]}) == {"sessions": expected}
    now[0] += 1000.0
    assert rejoins.answer({"sessions": ["aa"]}) == {"sessions": ["aa"]}
    assert closed == ["aa", "bb", "aa", "aa", "aa"]


def test_only_sessions_known_as_foreign_nodes_lose_their_links(hubs: QuickHub) -> None:
    """Clients of Midspan's sessions on other machines would lose their goals."""
    foreign, unknown = "2" * 32, "3" * 32
    with Hub.open(hubs.settings("one")) as hub, node_of_rmw(hubs, foreign) as node, node_of_rmw(hubs, unknown):
        token = node.liveliness().declare_token(
            node_key(NodeToken(hubs.domain, foreign, "0", "/", "controller_server"))
        )

        def asked() -> list[str]:
            answers = hub.ask(REJOIN, {"sessions": [hub.zid, foreign, unknown]}, "*", "router")
            return [zid for answer in answers for zid in answer.value["sessions"]]

        assert until(asked, "the node joins again") == [foreign]
        token.undeclare()


@pytest.mark.parametrize("params", [{}, {"sessions": "aa"}, {"sessions": [1, None]}])
def test_malformed_requests_close_no_link(hubs: QuickHub, params: dict[str, Any]) -> None:
    with Hub.open(hubs.settings("one")) as hub:
        (answer,) = until(lambda: hub.ask(REJOIN, params, "*", "router"), "the router answers")
        assert answer.value == {"sessions": []}
