"""Exchanges definitions of message types among workers: a worker that lacks a definition asks the others."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from bridge.concurrency import WorkerPool
from bridge.hub.definitions import VERB, definition_among
from bridge.hub.node import Hub
from bridge.messages.transcode.conversion import SideType
from bridge.routing.edge import Edge

_log = logging.getLogger(__name__)

_ASK_AGAIN = 10.0
_ASK_SECONDS = 2.0


class TypeExchange:
    """The types that this worker publishes on the hub, and its requests for other workers' types."""

    def __init__(self, hub: Hub, edge: Edge, learned: Callable[[], None]) -> None:
        self._hub, self._edge, self._learned = hub, edge, learned
        self._offered: dict[str, SideType] = {}
        self._asked: dict[tuple[str, str], float] = {}
        self._lock = threading.Lock()
        self._pool = WorkerPool(1, f"midspan-{edge.side}-types")

    def serve(self) -> Callable[[], None]:
        """Respond to other workers' requests until the returned function is called."""
        return self._hub.serve(VERB, self._answer)

    def offer(self, hub_type: SideType) -> None:
        """Offer the type of a topic that this worker publishes on the hub."""
        with self._lock:
            self._offered[hub_type.name] = hub_type

    def ask(self, name: str, type_hash: str) -> None:
        """Request a definition from the other workers, at most every ten seconds, and pass it to `Edge.learn`."""
        now = time.monotonic()
        if now - self._asked.get((name, type_hash), -_ASK_AGAIN) < _ASK_AGAIN:
            return
        if len(self._asked) > 10_000:
            self._asked.clear()
        self._asked[name, type_hash] = now
        self._pool.submit(lambda: self._ask(name, type_hash))

    def close(self) -> None:
        self._pool.close(_ASK_SECONDS)

    def _answer(self, params: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            known = self._offered.get(str(params.get("name", "")))
        if known is None:
            return {}
        return {"name": known.name, "hash": known.type_id, "definition": known.definition}

    def _ask(self, name: str, type_hash: str) -> None:
        try:
            answers = self._hub.ask(VERB, {"name": name}, timeout=_ASK_SECONDS)
        except Exception:
            _log.exception("asking the hub for the definition of %s failed", name)
            return
        definition = definition_among(answers, type_hash)
        if definition is not None:
            self._edge.learn(name, definition)
            self._learned()
