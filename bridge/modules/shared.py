"""The parts that the modules of one process share: a session on the hub, and the store of maps and places."""

from __future__ import annotations

from threading import Lock

from bridge.config.model import Config
from bridge.hub.daemons import identity_of
from bridge.hub.diagnostics import has_subscribers
from bridge.hub.errors import HubClosedError
from bridge.hub.node import Hub
from bridge.hub.session import HubSession, HubSettings
from bridge.state_file import lane_folder
from bridge.stores.service import StoreService
from yarp_compat.wire.generation import Findings


def hub_settings(config: Config, node: str, worker: str) -> HubSettings:
    """Return the settings for a node on a configuration's hub; ``worker`` is the node's name on the control plane."""
    return HubSettings(
        domain=config.hub.domain,
        router=config.hub.listen,
        zenoh=config.hub.zenoh,
        shared_memory=config.hub.shared_memory,
        node=node,
        daemon=config.name,
        worker=worker,
        max_payload=config.limits.message_bytes,
        lane=lane_folder(config),
        identity=identity_of(config),
    )


class Shared:
    """Opens each part when a module first needs it. Safe to use from any thread.

    With one common session, a process has only one set of links, buffers and graphs, and a topic that several modules
    use is sent over a link only once.

    Args:
        config: the configuration; its ``hub`` and ``store`` do not change while the process runs.
        alone: name of the only module of this process; "" in the daemon's worker, which runs all modules.

    Attributes:
        stores: the process's store.
        findings: the detected releases of YARP clients, shared because one client may call several modules.
    """

    def __init__(self, config: Config, alone: str = "") -> None:
        self._config = config
        self._lock = Lock()
        self._session: HubSession | None = None
        self._closed = False
        self.stores = StoreService(config, alone, self.join)
        self.findings = Findings()

    def join(self, node: str, worker: str) -> Hub:
        """Open another node on the session; raises `HubError` if joining the hub fails."""
        with self._lock:
            if self._closed:
                raise HubClosedError("the hub session is closed")
            if self._session is None:
                self._session = HubSession.open(hub_settings(self._config, node, worker), shared=True)
            return Hub.on(self._session, node, worker)

    def diagnostics_wanted(self) -> bool:
        """Return whether `/diagnostics` has subscribers; False until a module has joined the hub."""
        session = self._session
        return session is not None and has_subscribers(session.graph)

    def close(self) -> None:
        """Close the store and the session. Safe to call twice."""
        self.stores.close()
        with self._lock:
            self._closed = True
            session, self._session = self._session, None
        if session is not None:
            session.close()
