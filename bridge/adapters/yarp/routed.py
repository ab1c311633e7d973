"""The topics that the engine's routes publish and subscribe to on YARP."""

from __future__ import annotations

import threading
from collections.abc import Callable

from bridge.adapters.yarp.contents import Contents
from bridge.adapters.yarp.plan import RoutedTopic
from bridge.adapters.yarp.ports import OwnPorts
from bridge.adapters.yarp.topics import InputPort, TopicOutput, YarpPublisher
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import SideType
from bridge.messages.yarp.codec import has_header
from bridge.routing.edge import Deliver, is_command


class RoutedTopics:
    """The routes' publishers and subscriptions. Safe to use from any thread.

    Args:
        ports: the ports that receive for the subscriptions; the name-server thread opens and closes them.
        wake: wakes the name-server thread, which updates the ports.

    Attributes:
        outputs: the published topics; must not be modified.
    """

    def __init__(self, registry: Registry, contents: Contents, ports: OwnPorts, wake: Callable[[], None]) -> None:
        self._registry, self._contents, self._ports, self._wake = registry, contents, ports, wake
        self._lock = threading.Lock()
        self.outputs: dict[str, TopicOutput] = {}
        self._subscriptions: dict[tuple[str, str], YarpSubscription] = {}

    def published(self) -> dict[str, TopicOutput]:
        """Return the published topics as they are now."""
        with self._lock:
            return dict(self.outputs)

    def subscribed(self) -> list[RoutedTopic]:
        """Return the topics with a subscription."""
        with self._lock:
            subscriptions = list(self._subscriptions.values())
        return [self.routed_topic(subscription.topic, subscription.side_type) for subscription in subscriptions]

    def routed_topic(self, topic: str, side_type: SideType) -> RoutedTopic:
        """Return a topic and its type, as the plan of the ports needs them."""
        local = self._registry.ros2(side_type.name).type_id
        return RoutedTopic(topic, side_type.name, "" if side_type.type_id == local else side_type.type_id)

    def connect(self, input_port: InputPort) -> None:
        """Connect an input port with its topic's subscription."""
        with self._lock:
            subscription = self._subscriptions.get((input_port.topic, input_port.type))
            if subscription is None:
                input_port.deliver_to(None)
            else:
                input_port.deliver_to(subscription.deliver, command=subscription.is_command)
        input_port.release()

    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> YarpSubscription:
        """Subscribe to a topic; its ports open as soon as the name server registers them."""
        subscription = YarpSubscription(self, topic, side_type, qos, deliver)
        with self._lock:
            self._subscriptions[topic, side_type.name] = subscription
        self._connect_all(topic, side_type.name)
        return subscription

    def unsubscribe(self, subscription: YarpSubscription) -> None:
        """Remove a closed subscription, and disconnect its ports from it."""
        key = subscription.topic, subscription.side_type.name
        with self._lock:
            if self._subscriptions.get(key) is not subscription:
                return
            del self._subscriptions[key]
        self._connect_all(*key)

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> YarpPublisher:
        """Publish a topic; its ports open as soon as the name server registers them. Raises `MessageTypeError`."""
        content = self._contents.of_topic(topic)
        routed_topic = self.routed_topic(topic, side_type)
        self._contents.codec(content, side_type.name, routed_topic.type_hash, content.profile)
        with self._lock:
            output = self.outputs.get(topic)
            if output is None:
                stamped = has_header(self._registry.schema(side_type.name, routed_topic.type_hash))
                output = self.outputs[topic] = TopicOutput(topic, side_type, stamped, self._contents)
            elif output.side_type != side_type:
                raise MessageTypeError(
                    f"{topic} has the type {output.side_type.name} on YARP", "rename one of the topics with a rule"
                )
            publisher = output.publisher(qos, self._closed)
        self._wake()
        return publisher

    def _closed(self, publisher: YarpPublisher) -> None:
        output = publisher.output
        with self._lock:
            if output.remove(publisher) and self.outputs.get(output.topic) is output:
                del self.outputs[output.topic]
        self._wake()

    def _connect_all(self, topic: str, type_name: str) -> None:
        for input_port in self._ports.input_ports():
            if (input_port.topic, input_port.type) == (topic, type_name):
                self.connect(input_port)
        self._wake()


class YarpSubscription:
    """A subscription to one topic; ``is_command``: whether its messages are commands."""

    lost = 0

    def __init__(self, topics: RoutedTopics, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> None:
        self._topics = topics
        self.is_command = is_command(qos)
        self.topic, self.side_type, self.deliver = topic, side_type, deliver

    def close(self) -> None:
        self._topics.unsubscribe(self)
