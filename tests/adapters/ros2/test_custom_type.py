"""A type without a package on this machine, between the edge and a real program that has it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.wire.qos import Qos
from bridge.interfaces.builder import build
from bridge.interfaces.cache import environment
from bridge.messages.registry import Registry
from tests.adapters.ros2.conftest import RunningEdge
from tests.peers.peer import Peer
from tests.support.wait import until

DEFINITION = """
std_msgs/Header header
string<=12 label
float64[3] force
geometry_msgs/Point[] contacts
uint8[] raw
"""
FIELDS = {
    "header": {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "hand"},
    "label": "thumb",
    "force": [1.5, -2.5, 3.0],
    "contacts": [{"x": 1.0, "y": 2.0, "z": 3.0}, {"x": -1.0, "y": 0.0, "z": 0.5}],
    "raw": [1, 2, 255],
}


@pytest.fixture(scope="module")
def touch_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("msgs")
    (folder / "touch_msgs" / "msg").mkdir(parents=True)
    (folder / "touch_msgs" / "msg" / "Touch.msg").write_text(DEFINITION)
    return folder


@pytest.fixture(scope="module")
def registry(touch_folder: Path) -> Registry:
    """The edge's registry, which has only the definition."""
    return Registry(folders=[touch_folder])


def test_a_custom_type_crosses_in_both_directions(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    prefix = build({"touch_msgs": {"msg/Touch.msg": DEFINITION}})
    native = peer(**environment([prefix]))
    publisher = native.advertise("/c/in", "touch_msgs/Touch")
    subscription = native.subscribe("/c/out", "touch_msgs/Touch")
    inbox = edge.subscribe("/c/in", "touch_msgs/msg/Touch")
    ours = edge.edge.advertise("/c/out", edge.type("touch_msgs/msg/Touch"), Qos())
    convert = edge.conversion("touch_msgs/msg/Touch").convert
    assert convert is not None
    (endpoint,) = until(lambda: [e for e in edge.edge.endpoints() if e.topic == "/c/in"], "it is listed")
    assert endpoint.type_id == edge.type("touch_msgs/msg/Touch").type_id
    assert edge.edge.to_hub(endpoint).target.name == "touch_msgs/msg/Touch"

    def received() -> list[dict[str, Any]]:
        native.publish(publisher, FIELDS)
        for payload, _, _ in inbox.messages:
            ours.send(convert(payload), "hub")
        return native.wait(subscription, 1, 0.1)

    assert until(received, "the message comes back")[0] == FIELDS
