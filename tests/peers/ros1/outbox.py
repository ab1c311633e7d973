"""Records a master's calls to nodes instead of making them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.adapters.ros1.master.registrations import Link


class RecordedCalls:
    """Calls by address, in order: method and parameters, without the caller ID."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.delayed: list[tuple[float, Callable[[], None]]] = []

    def publisher_update(self, api: str, topic: str, publishers: list[str]) -> None:
        self.calls.append((api, "publisherUpdate", topic, list(publishers)))

    def param_update(self, subscriber: Link, _subscribed_key: str, key: str, value: Any, **_more: bool) -> None:
        self.calls.append((subscriber.api, "paramUpdate", key, value))

    def shut_down(self, api: str, node: str, reason: str) -> None:
        self.calls.append((api, "shutdown", node, reason))

    def after(self, seconds: float, call: Callable[[], None]) -> None:
        self.delayed.append((seconds, call))

    def pop(self) -> list[tuple[Any, ...]]:
        """Return the calls since the previous `pop`."""
        calls, self.calls = self.calls, []
        return calls
