"""The methods of a master's API (http://wiki.ros.org/ROS/Master_API, http://wiki.ros.org/ROS/Parameter_Server_API).

Each returns ``[code, message, value]``: code 1 is success, -1 an error of the caller, 0 a failure. In cases
that the wiki leaves open, the replies are those of ``rosmaster`` 1.15; a test compares both.
"""

from __future__ import annotations

import logging
import math
import os
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

from bridge.adapters.ros1.master import checks
from bridge.adapters.ros1.master.checks import Check, InvalidError
from bridge.adapters.ros1.master.names import canonical, resolve
from bridge.adapters.ros1.master.parameters import ParameterTree
from bridge.adapters.ros1.master.registrations import Kind, Link, Registrations, RegistrationsFullError

_log = logging.getLogger("midspan.ros1.master")

Reply = list[Any]
"""``[code, message, value]``."""

REPLACED_SECONDS = 2.0
"""For this many seconds a replaced node cannot register.

The node may not have noticed its replacement yet, and would shut its successor down.
"""

NEW_SECONDS = 5.0
"""For this many seconds a subscriber counts as new, because an update of the publishers may overtake the reply to its
registration. rospy then drops the update, and roscpp disconnects from the publisher. So the update is repeated after
`REPEAT_SECONDS`."""

REPEAT_SECONDS = 2.0

GRAPH = (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE)


class Outbox(Protocol):
    """Queues calls to nodes; calls to the same address are made in order."""

    def publisher_update(self, api: str, topic: str, publishers: list[str]) -> None:
        """Report the publishers of a topic to a subscriber."""

    def param_update(
        self, subscriber: Link, subscribed_key: str, key: str, value: Any, *, repeated: bool = False
    ) -> None:
        """Report a parameter's value to a subscriber; ``repeated`` if no program has just set it."""

    def shut_down(self, api: str, node: str, reason: str) -> None:
        """Ask a node to shut down."""

    def after(self, seconds: float, call: Callable[[], None]) -> None:
        """Run ``call`` after ``seconds``."""


class _Subscriber(NamedTuple):
    """A topic, and the address of a node that has subscribed to it."""

    topic: str
    api: str


class MasterApi:
    """The API of a master, with its registrations and parameters. Thread-safe.

    Args:
        uri: the master's own address.
        outbox: queues the calls to nodes.
        changed: called after each change of registrations or parameters.
        shut_down: called when a client requests ``shutdown``; None to refuse such requests.
    """

    def __init__(
        self, uri: str, outbox: Outbox, changed: Callable[[], None] = lambda: None,
        shut_down: Callable[[], None] | None = None,
    ) -> None:  # fmt: skip
        self.uri = uri
        self.lock = threading.RLock()
        self.registrations = Registrations()
        self.parameters = ParameterTree()
        self._outbox, self._changed, self._shut_down = outbox, changed, shut_down
        self._replaced: dict[Link, float] = {}
        """Replaced nodes, each with the time of its replacement."""
        self._new_subscribers: dict[_Subscriber, float] = {}
        """New subscribers with the time of their registration, oldest first."""
        self._repeats: set[_Subscriber] = set()
        """Subscribers to which the update will be repeated."""
        key, api, any_name = checks.text("key"), checks.address("caller_api"), checks.name("node", root=True)
        topic, type_name = checks.name("topic"), checks.type_name("topic_type")
        service, service_api = checks.name("service"), checks.address("service_api")
        self.methods: dict[str, Callable[..., Reply]] = {
            "shutdown": self._checked(self.shut_down, 0, checks.anything),
            "getUri": self._checked(lambda _caller: [1, "", self.uri], ""),
            "getPid": self._checked(lambda _caller: [1, "", os.getpid()], -1),
            "deleteParam": self._checked(self.delete_param, 0, key),
            "setParam": self._checked(self.set_param, 0, key, checks.given("value")),
            "getParam": self._checked(self.get_param, 0, key),
            "searchParam": self._checked(self.search_param, 0, key),
            "subscribeParam": self._checked(self.subscribe_param, 0, api, key),
            "unsubscribeParam": self._checked(self.unsubscribe_param, 0, api, key),
            "hasParam": self._checked(self.has_param, False, key),
            "getParamNames": self._checked(lambda _: [1, "Parameter names", self.parameters.names()], []),
            "registerService": self._checked(self.register_service, 0, service, service_api, api),
            "lookupService": self._checked(self.lookup_service, "", service),
            "unregisterService": self._checked(self.unregister_service, 0, service, service_api),
            "registerSubscriber": self._checked(self.register_subscriber, [], topic, type_name, api),
            "unregisterSubscriber": self._checked(self.unregister_subscriber, 0, topic, api),
            "registerPublisher": self._checked(self.register_publisher, [], topic, type_name, api),
            "unregisterPublisher": self._checked(self.unregister_publisher, 0, topic, api),
            "lookupNode": self._checked(self.lookup_node, "", any_name),
            "getPublishedTopics": self._checked(self.published_topics, 0, checks.namespace("subgraph")),
            "getTopicTypes": self._checked(self.topic_types, []),
            "getSystemState": self._checked(self.system_state, [[], [], []]),
        }

    def _checked(self, function: Callable[..., Reply], failure: object, *check: Check) -> Callable[..., Reply]:
        """Return a method that checks its parameters, and reports errors as replies with the value ``failure``."""

        def method(*params: Any) -> Reply:
            if not params:
                return [-1, "missing required caller_id parameter", failure]
            if len(params) != len(check) + 1:
                return [-1, "Error: bad call arity", failure]
            caller = params[0]
            if not isinstance(caller, str):
                return [-1, "caller_id must be a string", failure]
            try:
                checks.short("caller_id", caller)
                values = [checked(value, caller) for checked, value in zip(check, params[1:], strict=True)]
                with self.lock:
                    return function(caller, *values)
            except (InvalidError, RegistrationsFullError) as err:
                return [-1, str(err), failure]
            except TypeError as err:
                return [-1, f"Error: invalid arguments: {err}", failure]
            except ValueError as err:
                return [0, f"Internal failure: {err}", failure]

        return method

    def shut_down(self, caller: str, message: object) -> Reply:
        """Shut the master down, if that is allowed."""
        if self._shut_down is None:
            return [0, "this master is a part of Midspan, which starts and stops it", 0]
        _log.info("shut down by %s: %s", caller, message)
        self._shut_down()
        return [1, "shutdown", 0]

    # -- parameters ----------------------------------------------------------------------------------------------------

    def delete_param(self, caller: str, key: str) -> Reply:
        """Delete a parameter or a namespace."""
        key = resolve(key, caller)
        try:
            self.parameters.delete(key)
        except KeyError:
            return [-1, f"parameter [{key}] is not set", 0]
        self._send_updates("", key, {})
        self._changed()
        return [1, f"parameter {key} deleted", 0]

    def set_param(self, caller: str, key: str, value: Any) -> Reply:
        """Set a parameter, or replace a namespace with a structure."""
        key = resolve(key, caller)
        self.parameters.set(key, value)
        self._send_updates(caller, key, value)
        self._changed()
        return [1, f"parameter {key} set", 0]

    def _send_updates(self, caller: str, key: str, value: Any) -> None:
        """Send a parameter's new value to its subscribers.

        The node that set the value receives only updates of keys inside a structure.
        """
        for update in self.parameters.updates(key, value, self.registrations.keys(Kind.PARAMETER)):
            for link in self.registrations.links(Kind.PARAMETER, update.subscribed_key):
                if update.inner or not caller or link.node != caller:
                    self._outbox.param_update(link, update.subscribed_key, update.key, update.value)

    def get_param(self, caller: str, key: str) -> Reply:
        """Return a parameter, or a namespace as a structure."""
        key = resolve(key, caller)
        try:
            return [1, f"Parameter [{key}]", self.parameters.get(key)]
        except KeyError:
            return [-1, f"Parameter [{key}] is not set", 0]

    def search_param(self, caller: str, key: str) -> Reply:
        """Return the full name of a key, searched from the calling node's namespace upwards."""
        name = self.parameters.search(caller, key)
        if not name:
            return [-1, f"Cannot find parameter [{key}] in an upwards search", ""]
        return [1, f"Found [{name}]", name]

    def subscribe_param(self, caller: str, api: str, key: str) -> Reply:
        """Return a parameter, and send its changes to the calling node from now on."""
        key = resolve(key, caller)
        try:
            value = self.parameters.get(key)
        except KeyError:
            value = {}
        self._register(Kind.PARAMETER, _subscribed(key), caller, api)
        self._changed()
        return [1, f"Subscribed to parameter [{key}]", value]

    def unsubscribe_param(self, caller: str, api: str, key: str) -> Reply:
        """Stop sending changes of a parameter to the calling node."""
        key = resolve(key, caller)
        self.drop_param_subscriber(Link(caller, api), _subscribed(key))
        return [1, f"Unsubscribe to parameter [{key}]", 1]

    def drop_param_subscriber(self, subscriber: Link, subscribed_key: str) -> None:
        """Remove a subscriber of a parameter, because it no longer accepts updates, for example."""
        with self.lock:
            self.registrations.unregister(Kind.PARAMETER, subscribed_key, *subscriber)
            self._changed()

    def has_param(self, caller: str, key: str) -> Reply:
        """Return whether a parameter or namespace is set."""
        key = resolve(key, caller)
        return [1, key, self.parameters.has(key)]

    # -- registrations -------------------------------------------------------------------------------------------------

    def register_service(self, caller: str, service: str, service_api: str, api: str) -> Reply:
        """Register the server of a service; it replaces the previous one."""
        self._register(Kind.SERVICE, service, caller, api, service_api)
        self._changed()
        return [1, f"Registered [{caller}] as provider of [{service}]", 1]

    def unregister_service(self, caller: str, service: str, service_api: str) -> Reply:
        """Unregister the server of a service."""
        return self._unregister(Kind.SERVICE, service, caller, service_api)

    def register_subscriber(self, caller: str, topic: str, type_name: str, api: str) -> Reply:
        """Register a subscriber; return the publishers."""
        self._register(Kind.SUBSCRIBER, topic, caller, api)
        self.registrations.set_type(topic, type_name, publisher=False)
        self._add_new_subscriber(_Subscriber(topic, api))
        self._changed()
        return [1, f"Subscribed to [{topic}]", self.registrations.apis(Kind.PUBLISHER, topic)]

    def unregister_subscriber(self, caller: str, topic: str, api: str) -> Reply:
        """Unregister a subscriber."""
        return self._unregister(Kind.SUBSCRIBER, topic, caller, api)

    def register_publisher(self, caller: str, topic: str, type_name: str, api: str) -> Reply:
        """Register a publisher, and report it to the topic's subscribers; return the subscribers."""
        self._register(Kind.PUBLISHER, topic, caller, api)
        self.registrations.set_type(topic, type_name, publisher=True)
        self._report_publishers([topic])
        self._changed()
        subscribers = self.registrations.apis(Kind.SUBSCRIBER, topic)
        return [1, f"Registered [{caller}] as publisher of [{topic}]", subscribers]

    def unregister_publisher(self, caller: str, topic: str, api: str) -> Reply:
        """Unregister a publisher, and report its removal to the topic's subscribers."""
        reply = self._unregister(Kind.PUBLISHER, topic, caller, api)
        if reply[2]:
            self._report_publishers([topic])
        return reply

    def _unregister(self, kind: Kind, name: str, caller: str, api: str) -> Reply:
        message, count = self.registrations.unregister(kind, name, caller, api)
        self._changed()
        return [1, message, count]

    def _register(self, kind: Kind, key: str, node: str, api: str, service_api: str = "") -> None:
        """Register a node; if it replaces another node of the same name, shut the other node down."""
        now = time.monotonic()
        if self._replaced:
            self._replaced = {link: at for link, at in self._replaced.items() if now - at < REPLACED_SECONDS}
            if Link(node, api) in self._replaced and node in self.registrations.nodes:
                raise InvalidError(f"a new node named [{node}] has replaced the node at {api}")
        removal = self.registrations.register(kind, key, node, api, service_api)
        if removal is not None:
            self._replaced[Link(node, removal.api)] = now
            self._outbox.shut_down(removal.api, node, "new node registered with same name")
            reported = key if kind is Kind.PUBLISHER else ""  # the caller of this method reports this topic
            self._report_publishers([topic for topic in removal.topics if topic != reported])

    def _add_new_subscriber(self, subscriber: _Subscriber) -> None:
        now = time.monotonic()
        self._new_subscribers.pop(subscriber, None)
        self._new_subscribers[subscriber] = now
        while now - self._new_subscribers[oldest := next(iter(self._new_subscribers))] > NEW_SECONDS:
            del self._new_subscribers[oldest]

    def _report_publishers(self, topics: Sequence[str]) -> None:
        now = time.monotonic()
        for topic in topics:
            publishers = self.registrations.apis(Kind.PUBLISHER, topic)
            for api in self.registrations.apis(Kind.SUBSCRIBER, topic):
                self._outbox.publisher_update(api, topic, publishers)
                subscriber = _Subscriber(topic, api)
                new = now - self._new_subscribers.get(subscriber, -math.inf) <= NEW_SECONDS
                if new and subscriber not in self._repeats:
                    self._repeats.add(subscriber)
                    self._outbox.after(REPEAT_SECONDS, partial(self._repeat, subscriber))

    def _repeat(self, subscriber: _Subscriber) -> None:
        with self.lock:
            self._repeats.discard(subscriber)
            topic, api = subscriber
            if api in self.registrations.apis(Kind.SUBSCRIBER, topic):
                self._outbox.publisher_update(api, topic, self.registrations.apis(Kind.PUBLISHER, topic))

    def set_reachable(self, node: str, api: str) -> None:
        """Record that a node has answered this master."""
        with self.lock:
            entry = self.registrations.nodes.get(node)
            if entry is not None and entry.api == api and not entry.reachable:
                entry.reachable = True
                self._changed()

    def remove_dead(self, node: str, api: str) -> bool:
        """Remove a dead node's registrations, and inform subscribers; return False if it is no longer registered."""
        with self.lock:
            entry = self.registrations.nodes.get(node)
            if entry is None or entry.api != api:
                return False
            self._report_publishers(self.registrations.remove_node(node).topics)
            self._changed()
            return True

    def report_all(self) -> None:
        """Send all subscribers the current publishers and parameters.

        An earlier master may have ended before sending them.
        """
        with self.lock:
            self._report_publishers(self.registrations.keys(Kind.SUBSCRIBER))
            for key in self.registrations.keys(Kind.PARAMETER):
                value = self.parameters.get(key) if self.parameters.has(key) else {}
                for link in self.registrations.links(Kind.PARAMETER, key):
                    self._outbox.param_update(link, key, key, value, repeated=True)

    # -- the graph -----------------------------------------------------------------------------------------------------

    def lookup_service(self, _caller: str, service: str) -> Reply:
        """Return the address of a service."""
        _, api = self.registrations.service_apis.get(service, ("", ""))
        return [1, f"rosrpc URI: [{api}]", api] if api else [-1, "no provider", ""]

    def lookup_node(self, _caller: str, node: str) -> Reply:
        """Return the address of a node."""
        entry = self.registrations.nodes.get(node)
        return [-1, f"unknown node [{node}]", ""] if entry is None else [1, "node api", entry.api]

    def published_topics(self, _caller: str, namespace: str) -> Reply:
        """Return the published topics of a namespace with their types."""
        prefix = namespace if namespace in ("", "/") else f"{namespace}/"
        topics = [t for t in self.registrations.keys(Kind.PUBLISHER) if t.startswith(prefix)]
        return [1, "current topics", [[topic, self.registrations.types[topic]] for topic in topics]]

    def topic_types(self, _caller: str) -> Reply:
        """Return all topics with their types."""
        return [1, "current system state", [list(item) for item in self.registrations.types.items()]]

    def system_state(self, _caller: str) -> Reply:
        """Return publishers, subscribers and services, each as a list of names with their nodes."""
        return [1, "current system state", [self.registrations.state(kind) for kind in GRAPH]]


def _subscribed(key: str) -> str:
    return key if key == "/" else canonical(key) + "/"
