"""A module's publisher builds messages only for subscribers, unless it is latched.

``at_once`` callbacks do not wait for the module's thread.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.clock import RunClock
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop
from tests.contract.hubside import HubSide
from tests.peers.hub.quick import QuickHub
from tests.support.wait import until

STRING = "std_msgs/msg/String"


@pytest.fixture
def hubs() -> Iterator[QuickHub]:
    network = QuickHub()
    yield network
    network.stop_router()


@pytest.fixture
def node(hubs: QuickHub) -> Iterator[ModuleNode]:
    loop = EventLoop("test")
    hub = Hub.open(hubs.settings("near"))
    loop.start()
    module_node = ModuleNode(hub, Registry(), loop, RunClock())
    yield module_node
    module_node.close()
    loop.close()
    hub.close()


@pytest.fixture
def far(hubs: QuickHub) -> Iterator[HubSide]:
    side = HubSide(Hub.open(hubs.settings("far")), Registry())
    yield side
    side.hub.close()


def test_message_is_built_only_for_subscribers(node: ModuleNode, far: HubSide) -> None:
    publisher = node.publisher("/said", STRING)
    created: list[str] = []

    def make(text: str) -> bytes:
        created.append(text)
        return publisher.encoded({"data": text})

    publisher.offer(lambda: make("nobody"))
    assert not created
    assert (publisher.counters.messages, publisher.counters.bytes) == (1, 0)
    received = far.subscribe("/said", "std_msgs/String")

    def arrived() -> list[dict[str, Any]]:
        publisher.offer(lambda: make("you"))
        return far.wait(received, 1, 0.2)

    assert until(arrived, "the message arrives")[0] == {"data": "you"}
    assert set(created) == {"you"}
    assert publisher.counters.bytes > 0


def test_latched_message_is_built_for_late_joiners(node: ModuleNode) -> None:
    created: list[bytes] = []
    publisher = node.publisher("/kept", STRING, Qos(durability=Durability.TRANSIENT_LOCAL, depth=1))

    def make() -> bytes:
        created.append(publisher.encoded({"data": "kept"}))
        return created[0]

    publisher.offer(make)
    assert len(created) == 1


def test_immediate_callbacks_do_not_wait_for_the_module(node: ModuleNode, far: HubSide) -> None:
    held, release = threading.Event(), threading.Event()
    at_once: list[int] = []
    later: list[int] = []
    node.subscription_cdr("/heard", STRING, lambda _: at_once.append(threading.get_ident()), at_once=True)
    node.subscription_cdr("/heard", STRING, lambda _: later.append(threading.get_ident()))

    def hold() -> None:
        held.set()
        release.wait(30.0)

    node.loop.post(hold)
    assert held.wait(40)
    out = far.advertise("/heard", "std_msgs/String")

    def arrived() -> bool:
        far.publish(out, {"data": "x"})
        return bool(at_once)

    until(arrived, "the message arrives while the module is busy")
    assert not later
    release.set()
    until(lambda: later, "the module receives the message, too")
    assert not set(at_once) & set(later)
