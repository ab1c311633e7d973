"""The console in the test's own process, on its own hub."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from bridge.stores.store import Store
from bridge.web.worker import Console
from tests.contract.hubside import HubSide
from tests.peers.hub.quick import QuickHub
from tests.stores.parts import Shared


class Desk:
    """A console, and a program on its hub (``far``)."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.hubs = QuickHub()
        self.far = HubSide(Hub.open(self.hubs.settings("far")), Registry())
        self.console = self.open()

    def open(self, **sections: Any) -> Console:
        config = Config.model_validate({
            "name": "here",
            "state": self._folder,
            "hub": {"listen": self.hubs.endpoint},
            "navigation": {"planner": "nav2"},
            **sections,
            "web": {"enabled": True, "listen": "127.0.0.1:0", **sections.get("web", {})},
        })  # fmt: skip
        console = Console(config)
        console.start()
        return console

    def open_with(self, **sections: Any) -> None:
        """Restart the console with other sections of the configuration."""
        self.console.close()
        self.console = self.open(**sections)

    @property
    def port(self) -> int:
        return self.console.server.port

    def close(self) -> None:
        self.console.close()
        self.far.hub.close()
        self.hubs.stop_router()


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk_ = Desk(tmp_path)
    yield desk_
    desk_.close()


@pytest.fixture
def store(desk: Desk, tmp_path: Path) -> Iterator[Store]:
    """Return a daemon's store on the console's hub."""
    with Shared(tmp_path, "here", desk.hubs.endpoint) as shared:
        yield shared.store
