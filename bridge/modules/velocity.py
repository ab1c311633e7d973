"""The velocity publisher of a module."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bridge.client.velocity import VelocityForm, VelocityPublisher
from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host

_PERIOD = 0.2
"""Seconds between two checks of the velocity type, so that the publisher is connected before the first velocity."""


class _Output:
    def __init__(self, host: Host, topic: str, type_name: str) -> None:
        self._node = host.node
        self._publisher = host.node.publisher(topic, type_name, Qos(depth=1), priority="command")

    def publish(self, message: Mapping[str, Any]) -> None:
        self._publisher.publish(message)

    def close(self) -> None:
        self._node.release(self._publisher)


def velocity_publisher(host: Host, topic: str) -> VelocityPublisher:
    """Open a velocity publisher with the type that ``navigation.stamped`` sets; use it on the module's thread."""
    section = host.config.navigation
    publisher = VelocityPublisher(
        host.node.hub.graph, VelocityForm(topic, section.stamped, section.base_frame), host.clock,
        lambda type_name: _Output(host, topic, type_name), host.log.warning,
    )  # fmt: skip
    host.loop.every(_PERIOD, publisher.follow)
    return publisher
