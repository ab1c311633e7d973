"""The edge itself, with what happens between two steps of its clerk."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.yarp.edge import YarpEdge
from bridge.adapters.yarp.names import OWNER
from bridge.config.model import Config
from bridge.hub.qos import Durability, Qos
from bridge.messages.registry import Registry
from tests.adapters.yarp.conftest import YarpPort
from tests.support.yarp_programs import Names
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient

REGISTRY = Registry()
STRING = REGISTRY.ros2("std_msgs/msg/String")
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
LISTENER: Any = SimpleNamespace(
    graph_changed=lambda: None, presence_changed=lambda: None, message_refused=lambda *_: None
)


def cdr(text: str) -> bytes:
    """A String on the hub."""
    content = text.encode() + b"\0"
    return b"\0\1\0\0" + len(content).to_bytes(4, "little") + content


@pytest.fixture
def names() -> Iterator[Names]:
    names = Names()
    yield names
    names.stop()


@pytest.fixture
def edge(names: Names, tmp_path: Path) -> Iterator[YarpEdge]:
    """One that is not started."""
    yarp = {"nameserver": "site", "address": names.endpoint, "poll": 0.1}
    edge = YarpEdge(Config.model_validate({"name": "here", "state": tmp_path, "yarp": yarp}), REGISTRY, tmp_path)
    yield edge
    edge.stop()


def test_who_connects_as_a_port_opens_gets_what_is_kept(
    names: Names, edge: YarpEdge, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = YarpPort(names, "/late")
    edge.advertise("/map_name", STRING, LATCHED).send(cdr("kitchen"), "far")
    port, mark = "/midspan/map_name:o", NameClient.set_property

    def marking(client: NameClient, name: str, key: str, *values: Any) -> None:
        if (name, key) == (port, OWNER) and not reader.core.inputs():
            connections.connect(names.client, port, reader.name)
        mark(client, name, key, *values)

    monkeypatch.setattr(NameClient, "set_property", marking)
    edge.start(LISTENER)
    assert reader.bottles(1, 20) == [["kitchen"]]
    reader.stop()
