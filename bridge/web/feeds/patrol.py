"""The feed of the patrol."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from bridge.web.feeds.feed import Feed


class PatrolFeed(Feed):
    """``patrol``: the current patrol, or how the last patrol ended."""

    def __init__(self) -> None:
        super().__init__("patrol")
        self._now: Mapping[str, Any] | None = None

    @override
    def open(self) -> None:
        self.put(self._now, "" if self._now else "no patrol yet")

    @override
    def close(self) -> None:
        """Do nothing: the feed has no subscriptions."""

    def publish(self, value: Mapping[str, Any]) -> None:
        """Publish a new state."""
        self._now = value
        self.put(value)
