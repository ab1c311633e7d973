"""Publications for absent action servers stay open for a while after their release, up to a limit."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import pytest

from bridge.adapters.ros1.actions import network
from bridge.adapters.ros1.actions.network import LingeringPublishers
from bridge.hub.wire.qos import Qos
from bridge.messages.transcode.conversion import SideType

GOAL, OTHER = SideType("test_msgs/GoAction", "1", ""), SideType("test_msgs/ComeAction", "2", "")


class TopicPublisher:
    """A publication that records whether it is open."""

    dropped = 0
    subscribers: Mapping[str, int] = MappingProxyType({})

    def __init__(self, topic: str) -> None:
        self.topic, self.open = topic, True
        self.sent: list[bytes] = []

    def send(self, payload: bytes, _source: str) -> None:
        self.sent.append(payload)

    def drop_source(self, source: str) -> None:
        """Do nothing, because no messages are retained."""

    def close(self) -> None:
        self.open = False


class Side:
    """Records publications, and has a set of absent servers."""

    def __init__(self) -> None:
        self.made: list[TopicPublisher] = []
        self.gone: set[str] = set()
        self.publishers = LingeringPublishers(self._publish, self.gone.__contains__)

    def _publish(self, topic: str, _type: SideType, _qos: Qos) -> TopicPublisher:
        self.made.append(TopicPublisher(topic))
        return self.made[-1]

    def open(self, topic: str = "/go/goal", side_type: SideType = GOAL) -> network.TopicPublisher:
        return self.publishers.publish(topic, side_type, Qos())


def test_a_publication_with_a_present_server_closes_at_once() -> None:
    side = Side()
    publisher = side.open()
    assert "/go/goal" in side.publishers
    publisher.close()
    assert "/go/goal" not in side.publishers
    assert not side.made[0].open


def test_a_publication_with_an_absent_server_lingers_and_is_reused() -> None:
    side = Side()
    first = side.open()
    side.gone.add("/go")
    first.close()
    side.publishers.tidy()
    assert "/go/goal" in side.publishers
    second = side.open()
    first.close()  # closing it no longer has an effect
    second.send(b"x", "")
    side.publishers.close()  # this publication is in use
    assert [(m.open, m.sent) for m in side.made] == [(True, [b"x"])]


def test_a_publication_of_another_type_replaces_it() -> None:
    side = Side()
    side.gone.add("/go")
    side.open().close()
    side.open(side_type=OTHER)
    assert [m.open for m in side.made] == [False, True]


def test_publications_linger_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    side = Side()
    side.gone.add("/go")
    monkeypatch.setattr(network, "KEPT_SECONDS", 0.0)
    side.open().close()
    used = side.open("/go/cancel")
    side.publishers.tidy()
    assert [m.open for m in side.made] == [False, True]
    assert "/go/goal" not in side.publishers
    used.close()
    side.publishers.tidy()
    assert not any(m.open for m in side.made)


def test_the_number_of_lingering_publications_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    side = Side()
    monkeypatch.setattr(network, "_MOST", 2)
    names = [f"/go{n}" for n in range(4)]
    side.gone.update(names)
    for name in names:
        side.open(f"{name}/goal").close()
    assert [m.open for m in side.made] == [False, False, True, True]
    side.publishers.close()
    assert not any(m.open for m in side.made)
