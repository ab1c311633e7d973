"""Tests of a topic's feed when its publishers pause or leave, or when the hub refuses the subscription."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import pytest
import zenoh
from typing_extensions import override

from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.errors import HubError
from bridge.hub.graph import HubEndpoint
from bridge.hub.wire.keys import NO_HASH
from bridge.web.feeds import topics
from bridge.web.feeds.feed import Watcher
from bridge.web.feeds.images import ImageFeed
from bridge.web.feeds.topics import NewestFeed
from tests.peers.hub.endpoints import endpoint


class LengthFeed(NewestFeed):
    """Shows the number of bytes of the newest message."""

    @override
    def value(self, type_name: str, type_hash: str, cdr: bytes) -> dict[str, Any]:
        return {"bytes": len(cdr)}


class Surroundings:
    """Stands in for the console's loop and hub, an executor and a page; ``now`` is the time in seconds."""

    def __init__(self) -> None:
        self.node = self.hub = self.graph = self.loop = self
        self.endpoints: list[HubEndpoint] = [endpoint("/odom", b"1" * 16)]
        self.refusal = ""
        self.now = 100.0
        self.callbacks: list[Callable[[HubSample], None]] = []
        self.timers: dict[float, Callable[[], None]] = {}
        self.texts: list[str] = []
        self.lost = self.refused = 0
        self.numbers = itertools.count(1)

    def publishers(self, _topic: str) -> list[HubEndpoint]:
        return self.endpoints

    def subscription(self, *arguments: Any, exact: bool) -> Surroundings:
        assert exact, "the feed receives the message as published"
        if self.refusal:
            raise HubError(self.refusal)
        self.callbacks.append(arguments[-1])
        return self

    def close(self) -> None:
        self.callbacks.clear()

    def every(self, seconds: float, action: Callable[[], None]) -> Surroundings:
        self.timers[seconds] = action
        return self

    def submit(self, job: Callable[[], None]) -> None:
        job()

    post = submit

    def changed(self, _name: str, _n: int, text: str) -> None:
        self.texts.append(text)

    def second(self, messages: int = 0) -> str:
        """Publish messages within one second; return the newest text on the page."""
        for _ in range(messages):
            for callback in self.callbacks:
                callback(HubSample(zenoh.ZBytes(b"data"), next(self.numbers), 1, b"1" * 16, "1"))
            self.timers[topics.TOPIC_SECONDS]()
        self.now += topics.RATE_SECONDS
        self.timers[topics.RATE_SECONDS]()
        return self.texts[-1]


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch) -> Surroundings:
    place = Surroundings()
    monkeypatch.setattr("time.monotonic", lambda: place.now)
    return place


def watch(place: Surroundings) -> None:
    anything: Any = place
    page: Watcher = place
    LengthFeed(anything, anything, "topic:/odom", "/odom").watch(page)


def test_the_rate_of_a_publisher_that_pauses_is_zero(place: Surroundings) -> None:
    watch(place)
    place.second(10)
    assert '"bytes":4,"rate":10.0' in place.second(10)
    assert '"bytes":4,"rate":0.0' in place.second()


def test_a_publisher_without_a_type_hash_does_not_double_the_rate(place: Surroundings) -> None:
    """The subscription to the other publisher's hash also receives this publisher's messages."""
    place.endpoints.append(dataclasses.replace(endpoint("/odom", b"2" * 16), type_hash=NO_HASH))
    watch(place)
    place.second(10)
    assert '"rate":10.0' in place.second(10)


def test_a_message_is_withdrawn_with_its_last_publisher(place: Surroundings) -> None:
    watch(place)
    assert '"bytes":4' in place.second(10)
    place.endpoints = []
    assert "no publisher of /odom on the hub" in place.second()
    assert not place.callbacks, "the feed has unsubscribed"
    place.endpoints = [endpoint("/odom", b"2" * 16)]
    place.second()
    assert '"bytes":4' in place.second(1)


def test_a_closed_feed_keeps_no_message(place: Surroundings) -> None:
    """A message may be in the shared memory of its sender, which has little of it."""
    anything: Any = place
    page: Watcher = place
    feed = LengthFeed(anything, anything, "topic:/odom", "/odom")
    feed.watch(page)
    (callback,) = place.callbacks
    callback(HubSample(zenoh.ZBytes(b"data"), 1, 1, b"1" * 16, "1"))
    feed.unwatch(page)
    assert feed._newest is None


def test_the_reason_why_a_topic_cannot_be_subscribed_is_shown(place: Surroundings) -> None:
    place.refusal = "the session is closed"
    watch(place)
    assert "cannot subscribe to /odom: the session is closed" in place.second()


@pytest.mark.parametrize("width", ["", "161", "²", "1" * 5000])
def test_an_image_feed_of_an_unknown_width_is_refused(width: str) -> None:
    unused: Any = None
    with pytest.raises(LookupError, match="is not an image feed"):
        ImageFeed(unused, unused, unused, f"image:{width}:/camera")
