"""The console in the test's own process, on its own hub."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.stores.store import Store
from bridge.web.worker import Console
from tests.peers.hub.rig import HubRig
from tests.stores.parts import Shared


class Desk(HubRig):
    """A console, and a program on its hub (``far``)."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.console = self.open()

    def open(self, **sections: Any) -> Console:
        web = {"enabled": True, "listen": "127.0.0.1:0", **sections.pop("web", {})}
        console = Console(self.config(**{"navigation": {"planner": "nav2"}, **sections, "web": web}))
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
        super().close()


@pytest.fixture(autouse=True)
def _calls_may_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """Extend the time after which a waiting call is not executed: a busy machine may start its thread 3 s late."""
    monkeypatch.setattr("bridge.web.verbs.verbs.BEGIN_SECONDS", 60.0)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with Desk(tmp_path) as desk_:
        yield desk_


@pytest.fixture
def store(desk: Desk, tmp_path: Path) -> Iterator[Store]:
    """Return a daemon's store on the console's hub."""
    with Shared(tmp_path, "here", desk.hubs.endpoint) as shared:
        yield shared.store
