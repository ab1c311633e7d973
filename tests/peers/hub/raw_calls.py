"""Helpers for tests of services: requests and replies by their fields, and recorded results."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from bridge.hub.endpoints.calls import Abandon, Call, CallError, Done
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter

SET_BOOL = "std_srvs/srv/SetBool"
ECHO = "diagnostic_msgs/srv/AddDiagnostics"
"""A service type whose response can hold the text of a request."""


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


class Ends:
    """Records the results of calls."""

    def __init__(self) -> None:
        self._turn = threading.Condition()
        self.all: list[bytes | CallError] = []

    def done(self, result: bytes | CallError) -> None:
        with self._turn:
            self.all.append(result)
            self._turn.notify_all()

    def wait(self, count: int = 1, seconds: float = 40.0) -> list[bytes | CallError]:
        with self._turn:
            assert self._turn.wait_for(lambda: len(self.all) >= count, seconds), f"{len(self.all)} of {count} ended"
            return list(self.all)

    def replies(self, count: int = 1, seconds: float = 40.0) -> list[bytes]:
        """Wait for ``count`` replies; fails if a call ended with an error."""
        result = self.wait(count, seconds)
        return [reply for reply in result if isinstance(reply, bytes) or fail(reply)]

    def error(self) -> str:
        """Return the error of the only call."""
        (end,) = self.wait()
        assert isinstance(end, CallError), end
        return str(end)


def fail(error: CallError) -> bool:
    raise AssertionError(f"the call failed: {error}")


class Asked:
    """Records the requests to a server of the edge; the test replies."""

    def __init__(self) -> None:
        self._turn = threading.Condition()
        self.requests: list[tuple[bytes, Done]] = []
        self.abandoned = 0

    def call(self, request: bytes, done: Done) -> Abandon:
        with self._turn:
            self.requests.append((request, done))
            self._turn.notify_all()
        return self._abandon

    def _abandon(self) -> None:
        with self._turn:
            self.abandoned += 1
            self._turn.notify_all()

    def wait(self, count: int = 1, seconds: float = 40.0) -> list[tuple[bytes, Done]]:
        with self._turn:
            assert self._turn.wait_for(lambda: len(self.requests) >= count, seconds), f"{len(self.requests)} came"
            return list(self.requests)


def nothing() -> None:
    """Abandon a call that has ended."""


def answering(response: bytes) -> Call:
    """Return a `Call` that replies at once."""

    def call(_request: bytes, done: Done) -> Abandon:
        done(response)
        return nothing

    return call
