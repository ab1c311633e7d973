"""The store of one process: its file in the state folder, its place on the hub. Opened at its first use."""

from __future__ import annotations

import logging
import os
import threading
from typing import Any

from bridge.config.model import Config
from bridge.config.state import worker_folder
from bridge.hub.errors import HubError
from bridge.hub.session import Hub, HubSettings
from bridge.stores.errors import StoreError
from bridge.stores.importing import import_at_start
from bridge.stores.replica import Limits, Replica
from bridge.stores.sharing import Share
from bridge.stores.store import Store
from bridge.stores.wire import prefix

_log = logging.getLogger(__name__)
_WORKER = "store"


class StoreService:
    """Safe to use from any thread.

    Args:
        config: the whole configuration.
        alone: the module that has this process for itself, "" in the daemon's own worker. It has a copy of its own.
    """

    def __init__(self, config: Config, alone: str = "") -> None:
        self._config = config
        self._name = f"{_WORKER}-{alone}" if alone else _WORKER
        self._lock = threading.Lock()
        self._open: tuple[Store, Share, Hub] | None = None
        self._closed = False

    @property
    def store(self) -> Store:
        """The store.

        Raises:
            StoreError: it is switched off, or its file cannot be used.
            HubError: the hub cannot be joined.
        """
        with self._lock:
            if self._open is None:
                if self._closed:
                    raise StoreError("the store is closed")
                if self._config.store.enabled is False:
                    raise StoreError("the store is switched off (store.enabled)")
                self._open = self._opened()
            return self._open[0]

    def trouble(self) -> str:
        """Open it where the configuration says that it is there always; why that cannot be, "" where it is well."""
        if self._config.store.enabled is True:
            try:
                _ = self.store
            except (StoreError, HubError) as err:
                return str(err)
        return ""

    def close(self) -> None:
        """Close it. Safe to call twice."""
        with self._lock:
            self._closed = True
            found, self._open = self._open, None
        if found is not None:
            store, share, hub = found
            share.close()
            hub.close()
            store.replica.close()

    def _opened(self) -> tuple[Store, Share, Hub]:
        config = self._config
        section = config.store
        limits = Limits(section.keys, section.megabytes << 20, section.deleted, section.deleted_days)
        replica = Replica(worker_folder(config) / f"{self._name}.sqlite", config.name, limits)
        try:
            store = Store(replica)
            import_at_start(store, section)
            hub = self._joined()
            share = Share(replica, hub.keyspace(prefix(config.hub.domain)), hub.zid)
        except BaseException:
            replica.close()
            raise
        hub.serve("status", lambda _params: self._status(store, share, hub))
        return store, share, hub

    def _joined(self) -> Hub:
        config = self._config
        return Hub.open(
            HubSettings(
                domain=config.hub.domain,
                router=config.hub.listen,
                zenoh=config.hub.zenoh,
                shared_memory=config.hub.shared_memory,
                node=f"midspan_{self._name.replace('-', '_')}",
                daemon=config.name,
                worker=self._name,
                max_payload=config.limits.message_bytes,
            )
        )

    def _status(self, store: Store, share: Share, hub: Hub) -> dict[str, Any]:
        found = store.status()
        counts = ", ".join(f"{count} {kind}{'' if count == 1 else 's'}" for kind, count in found["keys"].items())
        others = share.others()
        shared = f"shared with {', '.join(others)}" if others else "shared with no other"
        return {
            "daemon": self._config.name,
            "worker": self._name,
            "module": True,
            "pid": os.getpid(),
            "zid": hub.zid,
            "state": "running",
            "text": f"{counts or 'empty'}; {shared}",
            "routes": [],
            "refused": [],
            "warnings": [],
            "store": {**found, "others": others, "refused": share.refused},
        }
