"""Servers and calls in the test's own process, by fields; parameters as in `tests.peers.peer`."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from bridge.hub.endpoints.calls import Abandon, Call, CallError, Done
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry


class Serving:
    """A server with one answer to all requests: a reply's fields, or an error; optionally held until `release`."""

    def __init__(self, registry: Registry, type_name: str, params: dict[str, Any]) -> None:
        self._registry, self._type = registry, type_name
        error, reply = params.get("error"), params.get("reply") or {}
        self._answer = CallError(error) if error else from_json(registry, f"{type_name}_Response", reply)
        self._held = bool(params.get("held"))
        self._requests: list[dict[str, Any]] = []
        self._waiting: list[Done] = []
        self._changed = threading.Condition()
        self.abandoned = 0

    def call(self, request: bytes, done: Done) -> Abandon:
        with self._changed:
            self._requests.append(to_json(self._registry, f"{self._type}_Request", request))
            held = self._held
            if held:
                self._waiting.append(done)
            self._changed.notify_all()
        if not held:
            done(self._answer)
        return self._abandon

    def _abandon(self) -> None:
        with self._changed:
            self.abandoned += 1
            self._changed.notify_all()

    def requests(self, count: int = 1, seconds: float = 40.0) -> list[dict[str, Any]]:
        with self._changed:
            self._changed.wait_for(lambda: len(self._requests) >= count, seconds)
            return list(self._requests)

    def release(self) -> None:
        with self._changed:
            self._held, waiting = False, self._waiting
        for done in waiting:
            done(self._answer)


class Calling:
    """One call, and its outcome."""

    def __init__(self, registry: Registry, type_name: str, request: dict[str, Any], call: Call) -> None:
        self._registry, self._type = registry, type_name
        self._ends: list[bytes | CallError] = []
        self._ended = threading.Event()
        self.abandon: Callable[[], None] = call(from_json(registry, f"{type_name}_Request", request), self._done)

    def _done(self, result: bytes | CallError) -> None:
        self._ends.append(result)
        self._ended.set()

    def result(self, seconds: float = 20.0) -> dict[str, Any]:
        if not self._ended.wait(seconds):
            return {"done": False, "reply": None, "error": ""}
        (end,) = self._ends
        if isinstance(end, CallError):
            return {"done": True, "reply": None, "error": str(end)}
        return {"done": True, "reply": to_json(self._registry, f"{self._type}_Response", end), "error": ""}
