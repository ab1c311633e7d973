"""Service calls in the test's own process, with fields or bytes; the parameters are those of `tests.peers.peer`."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from bridge.hub.endpoints.calls import Abandon, Call, CallError, Done
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from tests.peers.commands import Record

SET_BOOL = "std_srvs/srv/SetBool"
ECHO = "diagnostic_msgs/srv/AddDiagnostics"
"""A service type whose response can hold the text of a request."""


class Serving(Record):
    """A server with one answer to all requests (a reply's fields, or an error), which may be held until `release`."""

    def __init__(self, registry: Registry, type_name: str, params: dict[str, Any]) -> None:
        super().__init__()
        self._registry, self._type = registry, type_name
        error, reply = params.get("error"), params.get("reply") or {}
        self._answer = CallError(error) if error else from_json(registry, f"{type_name}_Response", reply)
        self._held = bool(params.get("held"))
        self._waiting: list[Done] = []
        self._lock = threading.Lock()
        self.abandoned = 0

    def call(self, request: bytes, done: Done) -> Abandon:
        with self._lock:
            held = self._held
            if held:
                self._waiting.append(done)
        self.add(to_json(self._registry, f"{self._type}_Request", request))
        if not held:
            done(self._answer)
        return self._abandon

    def _abandon(self) -> None:
        with self._lock:
            self.abandoned += 1

    def requests(self, count: int = 1, seconds: float = 40.0) -> list[dict[str, Any]]:
        return self.wait(count, seconds)

    def release(self) -> None:
        with self._lock:
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


class Service:
    """Encodes and decodes the messages of one service type."""

    def __init__(self, registry: Registry, type_name: str) -> None:
        self.type = registry.service_ros2(type_name)
        self._request, self._response = registry.service_schemas(type_name)

    def request(self, **fields: Any) -> bytes:
        return MessageWriter(self._request).message(fields)

    def asked(self, request: bytes) -> Mapping[str, Any]:
        return MessageReader(self._request, request).message()

    def response(self, **fields: Any) -> bytes:
        return MessageWriter(self._response).message(fields)

    def answer(self, response: bytes) -> Mapping[str, Any]:
        return MessageReader(self._response, response).message()


class Ends(Record):
    """Records the results of calls."""

    def done(self, result: bytes | CallError) -> None:
        self.add(result)

    def wait(self, count: int = 1, seconds: float = 40.0, since: int = 0) -> list[bytes | CallError]:
        """Return all results so far; fails if ``count`` calls do not end in time."""
        results = super().wait(count, seconds, since)
        assert len(self.items) >= count, f"{len(self.items)} of {count} ended"
        return results

    def replies(self, count: int = 1, seconds: float = 40.0) -> list[bytes]:
        """Wait for ``count`` replies; fails if a call ended with an error."""
        results = self.wait(count, seconds)
        return [reply for reply in results if isinstance(reply, bytes) or fail(reply)]

    def error(self) -> str:
        """Return the error of the only call."""
        (end,) = self.wait()
        assert isinstance(end, CallError), end
        return str(end)


def fail(error: CallError) -> bool:
    raise AssertionError(f"the call failed: {error}")


class Asked(Record):
    """Records the requests to a server of the adapter; the test replies."""

    def __init__(self) -> None:
        super().__init__()
        self.abandoned = 0

    def call(self, request: bytes, done: Done) -> Abandon:
        self.add((request, done))
        return self._abandon

    def _abandon(self) -> None:
        self.abandoned += 1

    def wait(self, count: int = 1, seconds: float = 40.0, since: int = 0) -> list[tuple[bytes, Done]]:
        """Return all requests so far, each with the function that replies; fails if ``count`` do not arrive in time."""
        requests = super().wait(count, seconds, since)
        assert len(self.items) >= count, f"{len(self.items)} of {count} arrived"
        return requests


def nothing() -> None:
    """Abandon a call that has ended."""


def answering(response: bytes) -> Call:
    """Return a `Call` that replies at once."""

    def call(_request: bytes, done: Done) -> Abandon:
        done(response)
        return nothing

    return call
