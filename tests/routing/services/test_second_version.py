"""Servers with the same name and type, but different versions of the type."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.config.sections.routing import RoutingSection
from bridge.hub.endpoints.calls import Call, Done, nothing
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from bridge.routing.engine import Engine
from bridge.routing.versions import second_version
from tests.peers.fake import FakeEdge, FakeNetwork
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

SERVICE, CLEAR = "std_srvs/srv/SetBool", "nav2_msgs/srv/ClearEntireCostmap"
UNKNOWN = "RIHS01_" + "1" * 64


def served(_request: bytes, _done: Done) -> Any:
    return nothing


def test_a_server_that_cannot_be_bridged_leaves_its_name_to_another() -> None:
    """The first server has an unknown version of the type."""
    call: Call = served
    registry, network = Registry(), FakeNetwork()
    with HubNetwork() as hubs, Hub.open(hubs.settings("far")) as far, Hub.open(hubs.settings("near")) as near:
        engine = Engine(FakeEdge(network, registry), near, RoutingSection(), "near", pytest.fail)
        engine.start()
        try:
            far.server("/do", SERVICE, UNKNOWN, call)

            def decisions() -> list[str]:
                return sorted(line.kind for line in engine.decisions() if line.topic == "/do")

            until(lambda: decisions() == ["refused"], "the server is refused")
            far.server("/do", SERVICE, registry.service_ros2(SERVICE).type_id, call)
            until(lambda: decisions() == ["bridged", "refused"], "the other server is offered")
        finally:
            engine.stop()


def test_the_text_names_both_versions_and_the_cure() -> None:
    versions = Registry().releases
    jazzy, lyrical = versions.hashes(CLEAR)
    assert second_version(versions, "/clear", CLEAR, jazzy, lyrical) == (
        f"/clear is already offered with jazzy's version of {CLEAR}; this server has lyrical's version",
        "stop one of the servers, give one another name, or install the same version of the package for both",
    )
    reason, cure = second_version(versions, "/clear", CLEAR, jazzy, UNKNOWN)
    assert reason.endswith(f"this server has version {UNKNOWN}")
    assert cure.endswith("types.folders")
