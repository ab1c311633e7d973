"""Publishers on topics whose subscriptions may have several versions of the type."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping

from bridge.adapters.ros2.context import Closed
from bridge.adapters.ros2.topics.publisher import Ros2Publisher
from bridge.messages.errors import MessageError
from bridge.messages.transcode.conversion import Convert

_log = logging.getLogger(__name__)


class VersionedPublisher:
    """Publishes messages of the hub in each version that the subscriptions of a ROS 2 topic have.

    Each version has a publisher whose writers send to subscriptions of this version only; the publisher of this
    machine's version also sends to subscriptions whose version is unknown. The other publishers exist while there are
    subscriptions of their versions. If the topic is latched, a new publisher first publishes the last messages of all
    sources.

    Args:
        here: the publisher of this machine's version.
        others: the converters to the other versions, by hash; None if the bytes are the same.
        open_publisher: opens the publisher of another version.
        wanted: returns the versions of the current subscriptions.
        closed: called by `close`.
    """

    def __init__(
        self, here: Ros2Publisher, others: Mapping[str, Convert | None], open_publisher: Callable[[str], Ros2Publisher],
        wanted: Callable[[], Iterable[str]], closed: Closed,
    ) -> None:  # fmt: skip
        self.topic, self.qos, self.type_name = here.topic, here.qos, here.type_name
        self._here, self._converters, self._open_publisher = here, others, open_publisher
        self._wanted, self._closed = wanted, closed
        self._lock = threading.Lock()
        self._open = True
        self._publishers: dict[str, Ros2Publisher] = {}
        self._last: dict[str, deque[bytes]] = {}

    @property
    def dropped(self) -> int:
        """Always 0: DDS does not report what a slow reader missed."""
        return 0

    @property
    def has_subscribers(self) -> bool:
        """Whether another participant subscribes to the topic."""
        return self._here.has_subscribers

    def send(self, payload: bytes | memoryview, source: str) -> None:
        """Publish a source's message; raises `ConversionError` if a subscription's version cannot hold it."""
        with self._lock:  # a new version begins with this message or the one after it
            self._here.send(payload, source)
            if self.qos.latched and self._open:
                self._last.setdefault(source, deque(maxlen=max(1, self.qos.depth))).append(bytes(payload))
            failure: MessageError | None = None
            for version, publisher in self._publishers.items():
                try:
                    self._send(publisher, version, payload, source)
                except MessageError as err:
                    failure = err
        if failure is not None:
            raise failure

    def _send(self, publisher: Ros2Publisher, version: str, payload: bytes | memoryview, source: str) -> None:
        convert = self._converters[version]
        publisher.send(payload if convert is None else convert(bytes(payload)), source)

    def refit(self) -> None:
        """Open and close publishers as the versions of the subscriptions change."""
        self._here.refit()
        with self._lock:  # includes reading the graph: older versions must not be applied last
            wanted = self._converters.keys() & set(self._wanted())
            departed = [self._publishers.pop(version) for version in self._publishers.keys() - wanted]
            for version in sorted(wanted - self._publishers.keys()) if self._open else ():
                self._publishers[version] = self._start(version)
            current = list(self._publishers.values())
        for publisher in departed:
            publisher.close()
        for publisher in current:
            publisher.refit()

    def _start(self, version: str) -> Ros2Publisher:
        """Open the publisher of a version, and publish the last messages; the lock is held."""
        publisher = self._open_publisher(version)
        for source, messages in self._last.items():
            for payload in messages:
                try:
                    self._send(publisher, version, payload, source)
                except MessageError as err:
                    _log.warning("%s: a retained message was not published in another version: %s", self.topic, err)
        return publisher

    def drop_source(self, source: str) -> None:
        """Drop what is retained for a source; the topic stays advertised."""
        with self._lock:
            self._last.pop(source, None)
            publishers = [self._here, *self._publishers.values()]
        for publisher in publishers:
            publisher.drop_source(source)

    def close(self) -> None:
        """Destroy the writers. Safe to call twice."""
        with self._lock:
            self._open = False
            publishers = [self._here, *self._publishers.values()]
            self._publishers, self._last = {}, {}
        for publisher in publishers:
            publisher.close()
        self._closed(self)
