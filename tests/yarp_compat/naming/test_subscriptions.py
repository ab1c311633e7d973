"""When persistent connections are wanted, and when they end."""

from __future__ import annotations

import pytest

from tests.yarp_compat.naming.test_registry import Asked
from yarp_compat.naming import subscriptions
from yarp_compat.naming.subscriptions import WantedConnection


@pytest.fixture(name="ask")
def fixture_ask() -> Asked:
    """A registry with nothing in it."""
    return Asked()


def there(ask: Asked, *names: str) -> list[WantedConnection]:
    """Open ports; the connections that this wants."""
    ask.wishes.clear()
    for name in names:
        ask(f"register {name}")
        ask(f"announce {name}")
    return list(ask.wishes)


def test_wanted_when_both_are_there(ask: Asked) -> None:
    """With the second of them, in either order; again whenever one returns."""
    assert ask("subscribe /a udp://b") == ["[ok]"]
    assert there(ask, "/b") == []
    assert there(ask, "/a") == [WantedConnection("/a", "udp://b", anew=True)]
    ask("unregister /b")
    assert there(ask, "/a") == []
    assert there(ask, "/b") == [WantedConnection("/a", "udp://b", anew=True)]
    ask.wishes.clear()
    ask("announce /b")
    assert ask.wishes == [WantedConnection("/a", "udp://b")]
    assert ask("unsubscribe /a /b") == ["[ok]"]
    assert there(ask, "/b") == []


def test_wanted_at_once_between_ports_that_are_there(ask: Asked) -> None:
    """Nobody has to come back for it."""
    there(ask, "/a", "/b")
    ask("subscribe /a /b")
    assert ask.wishes == [WantedConnection("/a", "/b")]


def test_not_wanted_before_both_listen(ask: Asked) -> None:
    """A port is registered before it listens; one that was closed has to say again that it does."""
    ask("subscribe /a /b")
    ask("register /b")
    assert there(ask, "/a") == []
    ask("announce /b")
    assert ask.wishes == [WantedConnection("/a", "/b", anew=True)]
    ask("unregister /b")
    ask("register /b")
    assert there(ask, "/a") == []
    ask("announce /nobody")
    assert ask.wishes == []


def test_listing(ask: Asked) -> None:
    """As yarpserver lists them: all, those of a port, with mode and topic."""
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
    assert ask("subscribe /nobody") == ["subscriptions"]


def test_modes_end_with_their_port(ask: Asked) -> None:
    """``from`` ends with its source, ``to`` with its target."""
    there(ask, "/a", "/b", "/c")
    ask("subscribe /a /b from")
    ask("subscribe /a /c to")
    ask("unregister /b")
    assert len(ask("subscribe /b")[0].split("(subscription ")) == 2
    ask("unregister /a")
    assert ask("subscribe /b") == ["subscriptions"]
    assert len(ask("subscribe /c")[0].split("(subscription ")) == 2
    ask("unregister /c")
    assert ask("subscribe") == ["subscriptions"]


def test_topics(ask: Asked) -> None:
    """All that write to a topic are connected to all that read from it."""
    assert ask("topic") == [""]
    assert ask("topic /t") == ["[ok]"]
    assert ask("topic") == ['"/t"']
    there(ask, "/w", "/r1", "/r2")
    ask("subscribe /w topic://t")
    assert ask.wishes == []
    ask("subscribe topic://t /r1")
    ask("subscribe topic:/t tcp://r2")
    assert ask.wishes == [WantedConnection("/w", "/r1"), WantedConnection("/w", "tcp://r2")]
    assert there(ask, "/w2") == []
    ask("subscribe /w2 topic://t")
    assert set(ask.wishes) == {WantedConnection("/w2", "/r1"), WantedConnection("/w2", "tcp://r2")}
    assert set(there(ask, "/r1")) == {
        WantedConnection("/w", "/r1", anew=True),
        WantedConnection("/w2", "/r1", anew=True),
    }
    ask("untopic /t")
    assert ask("topic") == [""]
    assert there(ask, "/r1") == []


@pytest.mark.parametrize("command", ["subscribe /a /b sometimes", 'subscribe "" /b', 'subscribe /a "/b c"', 'topic ""'])
def test_what_is_not_taken(ask: Asked, command: str) -> None:
    """Bad names and modes."""
    assert ask(command) in (["[fail]"], ["subscriptions"])
    assert ask("subscribe") == ["subscriptions"]


def test_bounds(ask: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    """Persistent connections, topics, and what one command may want are counted."""
    monkeypatch.setattr(subscriptions, "MAX_SUBSCRIPTIONS", 2)
    monkeypatch.setattr(subscriptions, "MAX_TOPICS", 1)
    monkeypatch.setattr(subscriptions, "MAX_WISHES", 1)
    assert [ask(f"subscribe /a /b{i}") for i in range(3)] == [["[ok]"], ["[ok]"], ["[fail]"]]
    assert ask("subscribe /a /b0") == ["[ok]"]
    assert ask("topic /t") == ["[ok]"]
    assert ask("topic /u") == ["[fail]"]
    ask("unsubscribe /a /b0")
    assert ask("subscribe /a topic://u") == ["[fail]"]
    monkeypatch.setattr(subscriptions, "MAX_SUBSCRIPTIONS", 9)
    there(ask, "/w1", "/w2", "/r")
    ask("subscribe /w1 topic://t")
    ask("subscribe /w2 topic://t")
    ask("subscribe topic://t /r")
    assert len(ask.wishes) == 1
