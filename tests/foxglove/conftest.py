"""The Foxglove server in the test's own process, on its own hub."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.foxglove.worker import Live
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide, ros2_name
from tests.peers.browser.foxglove_app import App
from tests.peers.hub.quick import QuickHub
from tests.support.status_documents import check_document


class Desk:
    """A server, and a program on its hub (``far``)."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.hubs = QuickHub()
        self.far = HubSide(Hub.open(self.hubs.settings("far")), Registry())
        self.live = self.open()

    def open(self, **sections: Any) -> Live:
        config = Config.model_validate({
            "name": "here",
            "state": self._folder,
            "hub": {"listen": self.hubs.endpoint},
            **sections,
            "foxglove": {"enabled": True, "listen": "127.0.0.1:0", **sections.get("foxglove", {})},
        })  # fmt: skip
        live = Live(config)
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

    def status(self) -> dict[str, Any]:
        """Return the server's status document."""
        (answer,) = self.far.hub.ask("status", {}, worker="foxglove")
        assert isinstance(answer.value, dict)
        check_document(answer.value, "foxglove")
        return answer.value

    def close(self) -> None:
        self.live.close()
        self.far.hub.close()
        self.hubs.stop_router()


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk_ = Desk(tmp_path)
    yield desk_
    desk_.close()
