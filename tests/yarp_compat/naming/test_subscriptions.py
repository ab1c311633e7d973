"""Conditions under which persistent connections are made and end."""

from __future__ import annotations

import pytest

from tests.yarp_compat.naming.test_registry import TextRegistry
from yarp_compat.naming import subscriptions
from yarp_compat.naming.subscriptions import WantedConnection


@pytest.fixture(name="ask")
def fixture_ask() -> TextRegistry:
    """Return an empty registry."""
    return TextRegistry()


def open_ports(ask: TextRegistry, *names: str) -> list[WantedConnection]:
    """Open ports, and return the connections to make."""
    ask.connections.clear()
    for name in names:
        ask(f"register {name}")
        ask(f"announce {name}")
    return list(ask.connections)


def test_a_connection_is_made_when_both_ports_are_open(ask: TextRegistry) -> None:
    """The connection is made when the second port opens, in either order, and again when a port reopens."""
    assert ask("subscribe /a udp://b") == ["[ok]"]
    assert open_ports(ask, "/b") == []
    assert open_ports(ask, "/a") == [WantedConnection("/a", "udp://b", force=True)]
    ask("unregister /b")
    assert open_ports(ask, "/a") == []
    assert open_ports(ask, "/b") == [WantedConnection("/a", "udp://b", force=True)]
    ask.connections.clear()
    ask("announce /b")
    assert ask.connections == [WantedConnection("/a", "udp://b")]
    assert ask("unsubscribe /a /b") == ["[ok]"]
    assert open_ports(ask, "/b") == []


def test_a_port_that_registers_again_with_its_number_is_connected_again(ask: TextRegistry) -> None:
    """Its program was killed and started again; the writing port may still report itself as connected."""
    ask("subscribe /a /b")
    open_ports(ask, "/a")
    for _ in range(2):
        ask.connections.clear()
        ask("register /b tcp 127.0.0.1 10050")
        ask("announce /b")
        assert ask.connections == [WantedConnection("/a", "/b", force=True)]


def test_a_connection_between_open_ports_is_made_at_once(ask: TextRegistry) -> None:
    """No port has to reopen for it."""
    open_ports(ask, "/a", "/b")
    ask("subscribe /a /b")
    assert ask.connections == [WantedConnection("/a", "/b")]


def test_no_connection_is_made_before_both_ports_listen(ask: TextRegistry) -> None:
    """A port is registered before it listens; a reopened port must announce itself again."""
    ask("subscribe /a /b")
    ask("register /b")
    assert open_ports(ask, "/a") == []
    ask("announce /b")
    assert ask.connections == [WantedConnection("/a", "/b", force=True)]
    ask("unregister /b")
    ask("register /b")
    assert open_ports(ask, "/a") == []
    ask("announce /missing")
    assert ask.connections == []


def test_persistent_connections_are_listed(ask: TextRegistry) -> None:
    """The format is yarpserver's: all subscriptions, or those of one port, with mode and topic."""
    assert ask("subscribe") == ["subscriptions"]
    ask("subscribe /c /d from")
    ask("subscribe /a /b")
    ask("subscribe /a topic://t")
    assert ask("subscribe") == [
        'subscriptions (subscription (src "/a") (dest "/b")) (subscription (src "/a") (dest "topic://t") (topic 0 1))'
    ]
    ask("register /c")
    ask("subscribe /c /d from")
    assert ask("subscribe /c") == ['subscriptions (subscription (src "/c") (dest "/d") (mode from))']
    assert ask("subscribe /missing") == ["subscriptions"]


def test_a_mode_ends_a_connection_with_its_port(ask: TextRegistry) -> None:
    """``from`` ends with its source, ``to`` with its target."""
    open_ports(ask, "/a", "/b", "/c")
    ask("subscribe /a /b from")
    ask("subscribe /a /c to")
    ask("unregister /b")
    assert len(ask("subscribe /b")[0].split("(subscription ")) == 2
    ask("unregister /a")
    assert ask("subscribe /b") == ["subscriptions"]
    assert len(ask("subscribe /c")[0].split("(subscription ")) == 2
    ask("unregister /c")
    assert ask("subscribe") == ["subscriptions"]


def test_a_topic_connects_its_sources_to_its_targets(ask: TextRegistry) -> None:
    """Each source is connected to each target."""
    assert ask("topic") == [""]
    assert ask("topic /t") == ["[ok]"]
    assert ask("topic") == ['"/t"']
    open_ports(ask, "/w", "/r1", "/r2")
    ask("subscribe /w topic://t")
    assert ask.connections == []
    ask("subscribe topic://t /r1")
    ask("subscribe topic:/t tcp://r2")
    assert ask.connections == [WantedConnection("/w", "/r1"), WantedConnection("/w", "tcp://r2")]
    assert open_ports(ask, "/w2") == []
    ask("subscribe /w2 topic://t")
    assert set(ask.connections) == {WantedConnection("/w2", "/r1"), WantedConnection("/w2", "tcp://r2")}
    assert set(open_ports(ask, "/r1")) == {
        WantedConnection("/w", "/r1", force=True),
        WantedConnection("/w2", "/r1", force=True),
    }
    ask("untopic /t")
    assert ask("topic") == [""]
    assert open_ports(ask, "/r1") == []


@pytest.mark.parametrize("command", ["subscribe /a /b sometimes", 'subscribe "" /b', 'subscribe /a "/b c"', 'topic ""'])
def test_invalid_subscriptions_are_rejected(ask: TextRegistry, command: str) -> None:
    """Names and modes must be valid."""
    assert ask(command) in (["[fail]"], ["subscriptions"])
    assert ask("subscribe") == ["subscriptions"]


def test_subscriptions_are_bounded(ask: TextRegistry, monkeypatch: pytest.MonkeyPatch) -> None:
    """Persistent connections, topics, and the connections per command have limits."""
    monkeypatch.setattr(subscriptions, "MAX_SUBSCRIPTIONS", 2)
    monkeypatch.setattr(subscriptions, "MAX_TOPICS", 1)
    monkeypatch.setattr(subscriptions, "MAX_CONNECTIONS", 1)
    assert [ask(f"subscribe /a /b{i}") for i in range(3)] == [["[ok]"], ["[ok]"], ["[fail]"]]
    assert ask("subscribe /a /b0") == ["[ok]"]
    assert ask("topic /t") == ["[ok]"]
    assert ask("topic /u") == ["[fail]"]
    ask("unsubscribe /a /b0")
    assert ask("subscribe /a topic://u") == ["[fail]"]
    monkeypatch.setattr(subscriptions, "MAX_SUBSCRIPTIONS", 9)
    open_ports(ask, "/w1", "/w2", "/r")
    ask("subscribe /w1 topic://t")
    ask("subscribe /w2 topic://t")
    ask("subscribe topic://t /r")
    assert len(ask.connections) == 1
