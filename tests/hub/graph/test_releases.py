"""The ROS 2 releases of native nodes, derived from the tokens of each release's rmw_zenoh."""

from __future__ import annotations

from contextlib import closing

import pytest

from bridge.client.graph import endpoint_text
from bridge.hub.graph.releases import NativeNodes, native_nodes
from bridge.hub.node import Hub
from tests.peers.hub.endpoints import HASH, STREAM, TYPE
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.releases import RELEASES, Release, ReleaseNode, ReleasePublisher, ReleaseServer, Topic
from tests.support.wait import until

CHATTER = Topic("/chatter", TYPE, HASH, STREAM)
IMAGE = Topic("/image", "sensor_msgs/msg/Image", HASH, STREAM, array=True)
SERVICE = Topic("/do", "std_srvs/srv/SetBool", HASH)

BY_ANY_TOPIC = {"humble": "Humble"}
BY_IMAGES = {"humble": "Humble", "lyrical": "Lyrical or later"}


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: release.name)
def test_the_release_of_a_native_node_is_known_from_its_endpoints(network: HubNetwork, release: Release) -> None:
    """Jazzy and Kilted announce the same; Lyrical differs only for types with buffers."""
    with Hub.open(network.settings("midspan")) as hub:
        node = ReleaseNode(network.endpoint, network.domain, "camera", release)

        def groups() -> list[NativeNodes]:
            return native_nodes(hub.graph.endpoints())

        def known(text: str) -> list[NativeNodes]:
            return [NativeNodes(text, release.name == "humble", ("/camera",))]

        with closing(node):
            ends = [ReleasePublisher(node, CHATTER), ReleaseServer(node, SERVICE, lambda request: request)]
            until(lambda: len(hub.graph.endpoints()) == len(ends), "all endpoints are known")
            assert groups() == known(BY_ANY_TOPIC.get(release.name, "Jazzy or later"))
            ends.append(ReleasePublisher(node, IMAGE))
            text = BY_IMAGES.get(release.name, "Jazzy or Kilted")
            (image,) = until(lambda: hub.graph.publishers("/image"), "the image publisher is known")
            assert groups() == known(text), "a publisher of images narrows the release down"
            assert f"/camera (zenoh, on the hub itself, ROS 2 {text})" in endpoint_text(image)
            assert native_nodes(hub.graph.endpoints(), {node.zid}) == []
