"""Feeds for arbitrary topics: the newest message of each, converted for the page."""

from __future__ import annotations

import time
from abc import abstractmethod
from functools import partial
from typing import Any

from typing_extensions import override

from bridge.client.errors import ClientError
from bridge.client.topics import TopicFollower, TopicKey
from bridge.client.types import Types
from bridge.concurrency import SerialExecutor
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.errors import HubError
from bridge.messages.errors import ConversionError
from bridge.modules.host import Host
from bridge.web.feeds.feed import Feed
from bridge.web.sources.messages import cut

TOPIC_SECONDS = 0.2
RATE_SECONDS = 1.0
MOST_BYTES = 4 << 20


class NewestFeed(Feed):
    """A feed of a topic's newest message, updated at most five times a second.

    Args:
        executor: decodes the messages.
        name: the name that pages use.
        topic: ``/topic``, or ``/topic@type`` to choose one of several types.
    """

    most_bytes = MOST_BYTES

    def __init__(self, host: Host, executor: SerialExecutor, name: str, topic: str) -> None:
        super().__init__(name)
        self._host, self._executor = host, executor
        self._topic, _, self._type = topic.partition("@")
        self._follower = TopicFollower(host.node.hub, self._on_sample)
        self._newest: tuple[HubSample, str, str] | None = None
        self._count, self._since = 0, 0.0
        self._rate: float | None = None
        self._shown: dict[str, Any] | None = None
        self._timers: list[Any] = []
        self._busy = False

    @override
    def open(self) -> None:
        self._count, self._since, self._rate = 0, time.monotonic(), None
        self._newest = self._shown = None
        self._timers = [
            self._host.loop.every(TOPIC_SECONDS, self._decode_newest),
            self._host.loop.every(RATE_SECONDS, self._update_rate),
        ]
        self._subscribe()

    @override
    def close(self) -> None:
        for timer in self._timers:
            timer.close()
        self._follower.close()
        self._newest = None  # its payload may be in the sender's shared memory

    def _subscribe(self) -> None:
        all_publishers = self._host.node.hub.graph.publishers(self._topic)
        publishers = [end for end in all_publishers if self._type in ("", end.type_name)]
        types = sorted({end.type_name for end in publishers})
        if len(types) > 1:
            self._follower.close()
            several = f"{self._topic} is published with several types: {', '.join(types)}"
            self._show(None, f"{several}; watch {self.name}@TYPE to choose one")
            return
        self._follower.follow(publishers, leave=True)
        if not self._follower:
            wanted = f"{self._topic} as {self._type}" if self._type else self._topic
            self._show(None, f"no publisher of {wanted} on the hub")
            return
        troubles = self._follower.troubles
        if troubles and self._shown is None:
            self._show(None, f"cannot subscribe to {self._topic}: {troubles[0]}")

    def _on_sample(self, key: TopicKey, sample: HubSample) -> None:
        """Store the newest sample, on zenoh's thread."""
        self._newest = (sample, key.type_name, key.type_hash)
        self._count += 1

    def _update_rate(self) -> None:
        now = time.monotonic()
        self._rate, self._count, self._since = round(self._count / (now - self._since), 1), 0, now
        self._subscribe()
        if self._shown is not None and not self._rate and self._shown["rate"]:  # no message will update it
            self._show({**self._shown, "rate": self._rate})

    def _decode_newest(self) -> None:
        if self._busy:
            return
        newest, self._newest = self._newest, None
        if newest is not None:
            self._busy = True
            self._executor.submit(partial(self._decode, *newest))

    def _decode(self, sample: HubSample, type_name: str, type_hash: str) -> None:
        """Decode on a thread that may block, because the type's definition may have to be requested."""
        reason, value = "", None
        if len(sample.payload) > self.most_bytes:
            reason = f"a message of {len(sample.payload)} bytes is not shown: the limit is {self.most_bytes}"
        else:
            try:
                value = self.value(type_name, type_hash, sample.data())
            except (ClientError, ConversionError, HubError) as err:
                reason = str(err)
            except Exception as err:  # whatever a message contains, the feeds must continue
                reason = f"the message cannot be shown: {type(err).__name__}: {err}"
        self._host.loop.post(partial(self._on_decoded, type_name, value, reason))

    def _on_decoded(self, type_name: str, value: dict[str, Any] | None, reason: str) -> None:
        self._busy = False
        if self.watched and self._follower:
            self._show(None if value is None else {"type": type_name, **value, "rate": self._rate}, reason)

    def _show(self, shown: dict[str, Any] | None, reason: str = "") -> None:
        self._shown = shown
        self.put(shown, reason)

    @abstractmethod
    def value(self, type_name: str, type_hash: str, cdr: bytes) -> dict[str, Any]:
        """Convert a message for pages. May block.

        Raises `ClientError`, `ConversionError` or `HubError` if the message cannot be converted.
        """


class MessageFeed(NewestFeed):
    """``topic:/name``: the newest message as a tree."""

    def __init__(self, host: Host, types: Types, executor: SerialExecutor, name: str) -> None:
        super().__init__(host, executor, name, name.removeprefix("topic:"))
        self._types = types

    @override
    def value(self, type_name: str, type_hash: str, cdr: bytes) -> dict[str, Any]:
        """Return the message's fields, with long arrays and texts truncated."""
        return {"message": cut(self._types.decode(type_name, type_hash, cdr))}
