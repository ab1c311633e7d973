"""Feeds, which pages watch. A feed has a newest value, which is updated only while a page watches the feed."""

from __future__ import annotations

import json
import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, Protocol

_log = logging.getLogger("midspan.web")


class Watcher(Protocol):
    """A page; called on the module's thread."""

    def changed(self, name: str, n: int, text: str) -> None:
        """Receive a feed's new value; ``text`` is the message for the page."""


class Feed(ABC):
    """One feed. Used only on the module's thread.

    Args:
        name: the name that pages use.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._watchers: set[Watcher] = set()
        self._n = 0
        self._text = ""
        self._value = ""

    @property
    def watched(self) -> bool:
        """Whether any page watches the feed."""
        return bool(self._watchers)

    def watch(self, watcher: Watcher) -> None:
        """Send a page the newest value now and at every change; raises `LookupError` if the feed cannot be opened."""
        begins = not self._watchers
        self._watchers.add(watcher)
        if begins:
            try:
                self.open()
            except Exception as err:
                _log.exception("cannot open the feed %s", self.name)
                self.unwatch(watcher)
                raise LookupError(f"{self.name} cannot be opened: {err}") from None
        elif self._text:
            watcher.changed(self.name, self._n, self._text)

    def unwatch(self, watcher: Watcher) -> None:
        """Stop sending to a page; the feed is closed after the last page."""
        if watcher in self._watchers:
            self._watchers.discard(watcher)
            if not self._watchers:
                self.close()
                self._text = self._value = ""

    def put(self, value: Any, why: str = "") -> None:
        """Publish a value, or None with the reason ``why``; an unchanged value is not sent again."""
        if not self._watchers:
            return  # the value arrived after the last page had left
        document = {"value": value, "why": why} if value is None else {"value": value}
        text = _json(document)
        if text == self._value:
            return
        self._value = text
        self._n += 1
        head = _json({"op": "value", "feed": self.name, "n": self._n})
        self._text = f"{head[:-1]},{text[1:]}"
        for watcher in tuple(self._watchers):
            watcher.changed(self.name, self._n, self._text)

    @abstractmethod
    def open(self) -> None:
        """Start updating, for the first page."""

    @abstractmethod
    def close(self) -> None:
        """Stop updating."""


def _json(value: Any) -> str:
    try:
        return _ENCODER.encode(value)
    except ValueError:
        return _ENCODER.encode(finite(value))


_ENCODER = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def finite(value: Any) -> Any:
    """Return the value, with None for numbers that JSON cannot represent."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


Make = Callable[[str], Feed]


class Feeds:
    """All feeds of the console by name; some, such as those of topics (``topic:/name``), are created on request.

    Args:
        fixed: the feeds that always exist.
        factories: functions that create a feed from its name, by the name's prefix; they raise `LookupError` if the
            rest of the name is invalid.

    Attributes:
        fixed: the feeds that always exist, by name.
    """

    MOST_TOPICS = 100
    """Maximum number of feeds that all pages together may have created on request."""

    def __init__(self, fixed: list[Feed], factories: Mapping[str, Make]) -> None:
        self.fixed = {feed.name: feed for feed in fixed}
        self._factories = factories
        self._topics: dict[str, Feed] = {}

    def find(self, name: str) -> Feed:
        """Return the feed with this name; raises `LookupError` with the reason if the name is unknown."""
        if name in self.fixed:
            return self.fixed[name]
        make = next((make for begin, make in self._factories.items() if name.startswith(begin)), None)
        if make is None:
            known = ", ".join((*self.fixed, *(f"{begin}NAME" for begin in self._factories)))
            raise LookupError(f"unknown feed {name[:80]!r}; known: {known}")
        if name not in self._topics:
            self._topics = {topic: feed for topic, feed in self._topics.items() if feed.watched}
            if len(self._topics) >= self.MOST_TOPICS:
                raise LookupError(f"{self.MOST_TOPICS} topics are watched already; close some")
            self._topics[name] = make(name)
        return self._topics[name]

    def close(self) -> None:
        for feed in (*self.fixed.values(), *self._topics.values()):
            if feed.watched:
                feed.close()
