"""A module's endpoints on the hub: topics, servers and clients whose messages are Python values."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from bridge.client.services import ServiceClient
from bridge.clock import RunClock
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.services import ServiceCodec
from bridge.messages.template import MessageTemplate
from bridge.messages.values import MessageReader, MessageWriter
from bridge.modules.loop import EventLoop
from bridge.modules.services import ModuleServer, Serve
from bridge.routing.counters import Counters

_log = logging.getLogger(__name__)

OnMessage = Callable[[dict[str, Any]], None]


class ModulePublisher:
    """Publishes values on one topic; created by `ModuleNode.publisher`. Safe to use from any thread."""

    KIND = "publisher"

    def __init__(self, publisher: HubPublisher, registry: Registry, type_name: str) -> None:
        self.topic, self.type_name = publisher.topic, type_name
        self.counters = Counters()
        self._publisher = publisher
        self._schema = registry.schema(type_name)

    def publish(self, message: Mapping[str, Any]) -> None:
        """Publish a message; missing fields have their defaults.

        Raises `ConversionError` if a field is unknown, or its value does not fit the type.
        """
        self.publish_cdr(self.encoded(message))

    def encoded(self, message: Mapping[str, Any]) -> bytes:
        """Encode a message as CDR; raises like `publish`."""
        return MessageWriter(self._schema).message(message)

    def template(self, message: Mapping[str, Any], *changing: str) -> MessageTemplate:
        """Return a template for messages in which only the numbers in ``changing`` change; see `MessageTemplate`."""
        return MessageTemplate(self._schema, message, *changing)

    def offer(self, make: Callable[[], bytes]) -> None:
        """Create and publish a message if there may be a subscriber; otherwise only count a message of 0 bytes."""
        if self._publisher.pass_over():
            self.counters.crossed(0)
        else:
            self.publish_cdr(make())

    def publish_cdr(self, payload: bytes) -> None:
        """Publish a message that is already encoded as CDR."""
        self._publisher.put(payload)
        self.counters.crossed(len(payload))

    def close(self) -> None:
        self._publisher.close()


class Subscription:
    """Receives one topic; created by `ModuleNode.subscription`. A bounded queue drops the oldest messages."""

    KIND = "subscription"

    def __init__(
        self,
        node: Endpoints,
        topic: str,
        type_name: str,
        type_hash: str,
        on_message: Callable[[bytes], None],
        depth: int,
        *,
        at_once: bool = False,
    ) -> None:
        self.topic, self.type_name = topic, type_name
        self.counters = Counters()
        self._loop, self._on_message, self._at_once = node.loop, on_message, at_once
        self._check = node.registry.hub_check(type_name, type_hash)
        self._lock = threading.Lock()
        self._queue: deque[HubSample] = deque()
        self._depth = depth
        self.end: HubSubscription | None = None
        self.sender = b""  # the GID of the current message's publisher; valid on the module's thread
        self.sent_ns = 0  # the source time of the current message, ns on its publisher's clock

    def on_sample(self, sample: HubSample) -> None:
        """Queue a sample, or deliver it at once; runs on a receiving thread."""
        if self._at_once:
            self._give(sample)
            return
        if self._queue:
            sample.data()  # a message that has to wait must not occupy the sender's memory
        with self._lock:
            self._queue.append(sample)
            full = len(self._queue) > self._depth
            if full:
                self._queue.popleft()
        if full:
            self.counters.dropped("queue")
        else:
            # one action per sample, so that samples and other actions, such as a clock's timers, stay in order
            self._loop.post(self._run)

    def refused(self, reason: str, why: str) -> None:
        """Count a sample that the hub refused."""
        self.counters.dropped(reason)
        self.counters.failed(why)

    def tick(self) -> None:
        """Update the rate and the number of lost messages."""
        self.counters.tick()
        if self.end is not None:
            self.counters.missed(self.end.lost, self.end.losses)

    def _run(self) -> None:
        with self._lock:
            sample = self._queue.popleft() if self._queue else None
        if sample is not None:
            self._give(sample)

    def _give(self, sample: HubSample) -> None:
        try:
            payload = self._check(sample.data())
        except ConversionError as err:
            self.refused("bad", str(err))
            _log.warning("%s: message refused: %s", self.topic, err)
            return
        self.counters.crossed(len(payload))
        self.sender, self.sent_ns = sample.gid, sample.source_time_ns
        self._on_message(payload)

    def close(self) -> None:
        if self.end is not None:
            self.end.close()
        with self._lock:
            self._queue.clear()


class Endpoints:
    """The endpoints of a module's node on the hub, without its actions; see `bridge.modules.host.ModuleNode`.

    Attributes:
        hub: the node on the hub.
        registry: the known types.
        loop: the thread on which callbacks run.
        clock: the clock for stamps.
    """

    def __init__(self, hub: Hub, registry: Registry, loop: EventLoop, clock: RunClock) -> None:
        self.hub, self.registry, self.loop, self.clock = hub, registry, loop, clock
        hub.versions = registry.releases
        self._ends: list[ModulePublisher | Subscription | ModuleServer | ServiceClient] = []

    def publisher(
        self, topic: str, type_name: str, qos: Qos | None = None, *, priority: str = "stream"
    ) -> ModulePublisher:
        """Create a publisher; raises `bridge.messages.errors.MessageTypeError` for an unknown type."""
        side = self.registry.ros2(type_name)
        end = self.hub.publisher(topic, type_name, side.type_id, qos or Qos(), priority=priority)
        endpoint = ModulePublisher(end, self.registry, type_name)
        self._ends.append(endpoint)
        return endpoint

    def subscription(self, topic: str, type_name: str, on_message: OnMessage, qos: Qos | None = None) -> Subscription:
        """Receive a topic's messages as values on the module's thread; numeric arrays share the message's memory."""
        schema = self.registry.schema(type_name)
        return self.subscription_cdr(
            topic, type_name, lambda payload: on_message(MessageReader(schema, payload).message()), qos
        )

    def subscription_cdr(
        self,
        topic: str,
        type_name: str,
        on_message: Callable[[bytes], None],
        qos: Qos | None = None,
        *,
        at_once: bool = False,
    ) -> Subscription:
        """Receive a topic's messages as validated CDR bytes.

        Args:
            topic: name of the topic.
            type_name: type of the topic.
            on_message: called with each message, on the module's thread.
            qos: QoS of the subscription.
            at_once: call ``on_message`` on the receiving threads, concurrently; it must then only store the message.
        """
        side = self.registry.ros2(type_name)
        qos = qos or Qos()
        endpoint = Subscription(self, topic, type_name, side.type_id, on_message, max(qos.depth, 1), at_once=at_once)
        endpoint.end = self.hub.subscription(topic, type_name, side.type_id, qos, endpoint.on_sample, endpoint.refused)
        self._ends.append(endpoint)
        return endpoint

    def decode(self, type_name: str, cdr: bytes) -> dict[str, Any]:
        """Decode a message that was received as CDR."""
        return MessageReader(self.registry.schema(type_name), cdr).message()

    def server(
        self, name: str, type_name: str, serve: Serve, at_once: Callable[[dict[str, Any]], None] | None = None
    ) -> ModuleServer:
        """Serve a service (``std_srvs/srv/SetBool``); raises `bridge.messages.errors.MessageTypeError`.

        Args:
            name: name of the service.
            type_name: type of the service.
            serve: called with each request on the module's thread.
            at_once: called with each request before ``serve``, on a thread of the hub; it must not block.
        """
        endpoint = ModuleServer(self.hub, self.registry, self.loop, name, type_name, serve, at_once)
        self._ends.append(endpoint)
        return endpoint

    def client(self, name: str, type_name: str) -> ServiceClient:
        """Create a service client; raises `bridge.messages.errors.MessageTypeError`."""
        endpoint = ServiceClient(self.hub, name, ServiceCodec(self.registry, type_name), self.loop.post)
        self._ends.append(endpoint)
        return endpoint

    def release(self, end: ModulePublisher | Subscription | ModuleServer | ServiceClient) -> None:
        """Close one endpoint before the node is closed."""
        self._ends = [other for other in self._ends if other is not end]
        end.close()

    def tick(self) -> None:
        """Update the rates; called once a second."""
        for end in self._ends:
            if isinstance(end, Subscription):
                end.tick()
            else:
                end.counters.tick()

    def status(self) -> list[dict[str, Any]]:
        """Return the endpoints for the status document."""
        return [
            {"topic": end.topic, "type": end.type_name, "end": end.KIND, **end.counters.as_dict()} for end in self._ends
        ]

    def close(self) -> None:
        ends, self._ends = self._ends, []
        for end in ends:
            end.close()
