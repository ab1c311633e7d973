"""Reports the status of modules that cannot start, and therefore have no node on the hub."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from bridge.hub.errors import HubError
from bridge.hub.node import Hub
from bridge.status import ModuleStatus
from bridge.worker import StatusHead

_log = logging.getLogger(__name__)


class FailureReports:
    """Answers ``status`` for each failed module, as `bridge.modules.worker.Running` does for running modules.

    Args:
        daemon: the daemon's name.
        join: opens a node on the hub, given its node name and its name on the control plane.
    """

    def __init__(self, daemon: str, join: Callable[[str, str], Hub]) -> None:
        self._daemon, self._join = daemon, join
        self._troubles: Mapping[str, str] = {}
        self._nodes: dict[str, Hub] = {}

    def show(self, troubles: Mapping[str, str]) -> None:
        """Report exactly these modules, each with the reason why it does not run."""
        self._troubles = troubles
        for name in self._nodes.keys() - troubles.keys():
            self._nodes.pop(name).close()
        for name in troubles.keys() - self._nodes.keys():
            try:
                hub = self._join(name, name)
            except HubError as err:  # the next call retries
                _log.debug("%s cannot report its failure: %s", name, err)
                continue
            self._nodes[name] = hub
            hub.serve("status", partial(self._status, name, hub.zid))

    def close(self) -> None:
        """Stop reporting. Safe to call twice."""
        self.show({})

    def _status(self, name: str, zid: str, _params: dict[str, Any]) -> dict[str, Any]:
        head = StatusHead({"daemon": self._daemon, "worker": name, "module": True}, uptime=False, costs=False)
        fields = head.fields("waiting", self._troubles.get(name, ""), refused=[])
        return ModuleStatus(**fields, zid=zid, routes=[], warnings=[]).document()
