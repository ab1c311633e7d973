"""The Foxglove server in the test's own process, on its own hub."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.foxglove.worker import Live
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.wire.qos import Durability, Qos, Reliability
from tests.contract.hubside import ros2_name
from tests.peers.browser.foxglove_app import App
from tests.peers.hub.rig import HubRig
from tests.support.status_documents import check_document
from tests.support.wait import until


class Desk(HubRig):
    """A server, and a program on its hub (``far``)."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.live = self.open()

    def open(self, **sections: Any) -> Live:
        foxglove = {"enabled": True, "listen": "127.0.0.1:0", **sections.pop("foxglove", {})}
        live = Live(self.config(**sections, foxglove=foxglove))
        live.start()
        return live

    def open_with(self, **sections: Any) -> None:
        """Restart the server with other sections of the configuration."""
        self.live.close()
        self.live = self.open(**sections)

    def publisher(self, topic: str, type_: str) -> HubPublisher:
        """Return a publisher of the program, for raw payloads."""
        name = ros2_name(type_)
        qos = Qos(Reliability.RELIABLE, Durability.VOLATILE, depth=10)
        return self.far.hub.publisher(topic, name, self.far.registry.ros2(name).type_id, qos)

    def app(self, **options: Any) -> App:
        return App(self.live.front.port, **options)

    def status(self, worker: str = "foxglove") -> dict[str, Any]:
        """Return the server's status document."""
        status: dict[str, Any] = until(lambda: HubRig.status(self, worker), "the server reports its status")
        check_document(status, "foxglove")
        return status

    def close(self) -> None:
        self.live.close()
        super().close()


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with Desk(tmp_path) as desk_:
        yield desk_
