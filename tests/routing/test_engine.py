"""The work of an engine's loop must not disturb existing routes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import cast

import pytest

from bridge.config.sections.routing import RoutingSection
from bridge.hub.graph.tokens import TAPS, Origin
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.routing import side_to_hub
from bridge.routing.edge import Endpoint, MadeBy
from bridge.routing.engine import Engine, NetworkTokens
from bridge.routing.stall import StallDetector
from tests.peers.fake import FakeEdge, FakeNetwork
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until


class SlowEdge(FakeEdge):
    """An edge whose graph takes long to read, as when hundreds of routes are created at once."""

    def __init__(self, network: FakeNetwork, registry: Registry) -> None:
        super().__init__(network, registry)
        self.looked, self.go_on = threading.Event(), threading.Event()

    def endpoints(self) -> list[Endpoint]:
        self.looked.set()
        self.go_on.wait()
        return super().endpoints()


def test_busy_loop_is_not_a_suspension(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise, commands that arrive during the creation of hundreds of routes would be dropped as old."""
    beats, beat = list[None](), StallDetector.beat
    monkeypatch.setattr(StallDetector, "beat", lambda detector: beats.append(beat(detector)))
    with HubNetwork() as hubs, Hub.open(hubs.settings("busy")) as hub:
        edge = SlowEdge(FakeNetwork(), Registry())
        engine = Engine(edge, hub, RoutingSection(), "busy", lambda _: None)
        engine.start()
        try:
            assert edge.looked.wait(40)
            for _ in range(5):
                before = len(beats)
                until(lambda before=before: len(beats) > before, "the stall detector beats")
        finally:
            edge.go_on.set()
            engine.stop()


class RecordingHub:
    """Records the tokens that a session announces."""

    def __init__(self) -> None:
        self.graph = self
        self.members = set[str]()
        self.origins = list[Origin | None]()

    def set_origin(self, origin: Origin | None) -> None:
        self.origins.append(origin)

    def announce_member(self, member: str) -> Callable[[], None]:
        assert member not in self.members
        self.members.add(member)
        return lambda: self.members.remove(member)


def test_tokens_name_the_network_and_its_current_members() -> None:
    hub = RecordingHub()
    tokens = NetworkTokens(cast("Hub", hub), "ros1", "robot")
    assert tokens.network is None
    tokens.change("master-1")
    tokens.change(None)
    assert hub.origins == [Origin("ros1", "master-1", "robot"), None]
    for members in ({"a", "b"}, {"b", "c"}, set[str]()):
        tokens.announce_members(frozenset(members))
        assert hub.members == members


def test_tap_publishes_an_unbridged_topic_under_another_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(side_to_hub, "_TAP_ANSWER", 1000.0)
    network = FakeNetwork()
    network.write_on("/secret", "std_msgs/msg/String", Qos(), MadeBy.NATIVE, "/node")
    rules = RoutingSection.model_validate({"rules": [{"topic": "/secret", "deny": True}]})
    with HubNetwork() as hubs, Hub.open(hubs.settings("tap")) as hub:
        engine = Engine(FakeEdge(network, Registry()), hub, rules, "tap", pytest.fail)
        engine.start()
        try:
            until(engine.decisions, "the first check has run")
            assert engine.tap("/missing", 10.0) == {}
            answers = [engine.tap("/secret", 10.0) for _ in range(2)]
        finally:
            engine.stop()
    assert [answer["topic"] for answer in answers] == [f"{TAPS}fake/secret"] * 2
    assert answers[0]["type"] == "std_msgs/msg/String"
