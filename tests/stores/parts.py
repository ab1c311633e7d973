"""Common parts of the tests of synchronized stores: a deployment of stores, each with its own router."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.stores.replica import Replica, StoreLimits
from bridge.stores.sharing import StoreSync
from bridge.stores.store import Store
from bridge.stores.wire import prefix


class Shared:
    """A store on a router's hub.

    Args:
        folder: folder of its file.
        name: the daemon's name.
        router: endpoint that its session connects to, None to stay disconnected.
        limits: limits of the store.
        domain: the hub's domain.
    """

    def __init__(
        self, folder: Path, name: str, router: str | None, limits: StoreLimits | None = None, domain: int = 0
    ) -> None:
        self.name, self.domain = name, domain
        self.replica = Replica(folder / f"{name}.sqlite", name, limits)
        self.store = Store(self.replica)
        self.share: StoreSync | None = None
        self.hub: Hub | None = None
        if router is not None:
            self.join(router)

    def join(self, router: str) -> None:
        """Join a hub."""
        self.hub = Hub.open(
            HubSettings(self.domain, router, node=f"store_{self.name}", daemon=self.name, worker="store")
        )
        self.share = StoreSync(self.replica, self.hub.keyspace(prefix(self.domain)), self.hub.zid)

    def disconnect(self) -> None:
        """Leave the hub; the store keeps working on its own."""
        if self.share is not None and self.hub is not None:
            self.share.close()
            self.hub.close()
            self.share = self.hub = None

    def others(self) -> list[str]:
        """Return the daemons of the reachable replicas."""
        return self.share.others() if self.share is not None else []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.disconnect()
        self.replica.close()
