"""Messages and service calls that a page sends from a form."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import OrderedDict
from functools import partial
from typing import Any

from bridge.client.publishing import await_subscribers, encode
from bridge.client.services import ServiceCaller
from bridge.client.session import Client
from bridge.client.types import Types, ros2_spelling
from bridge.config.model import Config
from bridge.config.sections.section import ROS2_NAME
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.graph.tokens import TAPS, EndpointKind
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import split
from bridge.messages.velocities import VELOCITIES
from bridge.modules.host import Host
from bridge.routing.limits import Priority, RateLimit
from bridge.routing.rules import RuleSet
from bridge.web.sources.definitions import KINDS, definition
from bridge.web.sources.messages import cut
from bridge.web.verbs.verbs import PageVerb, VerbError

MOST_RATE = 5.0
"""Maximum number of messages per second from all pages together."""

MOST_TYPE = 255
CALL_SECONDS = 15.0
KEEP_SECONDS = 60.0
"""Seconds for which a topic's publisher is kept, so that the next message need not wait for discovery."""

_MOST_PUBLISHERS = 8
_SETTLE_SECONDS = 1.0  # to wait for subscribers to discover a new publisher
_END_SECONDS = 0.5  # for which `close` waits for a publishing thread


class Sending:
    """Publishes messages and calls services.

    All methods except `close` block, so never call them on the module's thread.
    """

    def __init__(self, host: Host, config: Config, client: Client, types: Types) -> None:
        self._host, self._client, self._types = host, client, types
        section = config.navigation
        self._velocities = {section.velocity, *(planner.velocity for planner in section.others.values())} - {""}
        self._rules = RuleSet(config.rules)
        self._limit = RateLimit(MOST_RATE)
        self._lock = threading.Lock()
        self._publishers: OrderedDict[tuple[str, str], tuple[HubPublisher, float]] = OrderedDict()

    def publish(self, topic: str, type: str, message: dict[str, Any]) -> str:  # noqa: A002 - the protocol's name
        """Publish one message; raises `VerbError` or `ClientError` with the reason if it cannot."""
        name = self._types.name(type)
        reason = self._refusal(topic, name)
        if reason:
            raise VerbError(reason)
        type_hash = self._types.hash_of(name)
        cdr = encode(self._types, name, message)
        with self._lock:
            if not self._limit.passes():
                raise VerbError(f"the limit is {MOST_RATE:g} messages per second from all pages; try again")
            publisher = self._publisher(topic, name, type_hash)
            publisher.put(cdr)
            received = publisher.matched()
        return f"published on {topic}" if received else f"published on {topic}, but the hub has no subscriber"

    def _refusal(self, topic: str, type_name: str) -> str:
        if topic.startswith(TAPS) or not ROS2_NAME.fullmatch(topic):
            return f"{topic[:80]!r} is not a topic name: /, then parts of letters, digits and underscores"
        commands = self._rules.native_class(topic, type_name, latched=False) is Priority.COMMAND
        if commands or type_name in VELOCITIES or topic in self._velocities:
            return (
                "velocities cannot be sent from a form, because nothing would stop the base: drive manually"
                " in the view Drive, which commands zero on release"
            )
        return ""

    def _publisher(self, topic: str, name: str, type_hash: str) -> HubPublisher:
        """Return the topic's publisher; wait a moment for subscribers of a new one. The caller holds the lock."""
        now, key = time.monotonic(), (topic, name)
        if key in self._publishers:
            publisher, _ = self._publishers.pop(key)
        else:
            publisher = self._client.hub.publisher(topic, name, type_hash, Qos(depth=1))
            await_subscribers(publisher, _SETTLE_SECONDS)
        self._publishers[key] = publisher, now
        while len(self._publishers) > _MOST_PUBLISHERS:
            self._publishers.popitem(last=False)[1][0].close()
        self._host.loop.post(partial(self._host.loop.after, KEEP_SECONDS + 1.0, self._tidy))
        return publisher

    def _tidy(self) -> None:
        if not self._lock.acquire(blocking=False):
            return  # a publishing thread holds the lock, and schedules `_tidy` again
        try:
            late = time.monotonic() - KEEP_SECONDS
            for key in [key for key, (_, used) in self._publishers.items() if used < late]:
                self._publishers.pop(key)[0].close()
        finally:
            self._lock.release()

    def call(self, name: str, type: str, request: dict[str, Any]) -> dict[str, Any]:  # noqa: A002
        """Call a service once, and return its reply. Raises `VerbError` or `ClientError`."""
        if not ROS2_NAME.fullmatch(name) or split(name)[1]:
            raise VerbError(f"{name[:80]!r} is not a service name")
        with contextlib.closing(ServiceCaller(self._client, self._types, name, ros2_spelling(type, "srv"))) as caller:
            reply: dict[str, Any] = cut(caller.ask(request, CALL_SECONDS))
        return reply

    def close(self) -> None:
        if self._lock.acquire(timeout=_END_SECONDS):  # otherwise a thread is publishing, and ends with the session
            while self._publishers:
                self._publishers.popitem()[1][0].close()
            self._lock.release()


def list_services(client: Client) -> list[dict[str, Any]]:
    """Return the value of ``services``: services with a server or client on the hub, except services of actions."""
    services: dict[tuple[str, str], dict[str, Any]] = {}
    ends = {EndpointKind.SERVER: "servers", EndpointKind.CLIENT: "clients"}
    for end in client.hub.graph.endpoints():
        if end.kind in ends and not end.topic.startswith(TAPS) and not split(end.topic)[1]:
            empty = {"service": end.topic, "type": end.type_name, "servers": 0, "clients": 0}
            services.setdefault((end.topic, end.type_name), empty)[ends[end.kind]] += 1
    return [services[key] for key in sorted(services)]


def sending_verbs(sending: Sending, types: Types) -> dict[str, PageVerb]:
    """Return the verbs by name."""
    text = {"topic": _text, "type": _text}
    return {
        "definition": PageVerb(
            lambda type, kind="topic": definition(types, type, kind),  # noqa: A006 - the protocol's name
            {"type": _text}, {"kind": _kind}, commands=False, slow=True,
        ),
        "publish": PageVerb(sending.publish, {**text, "message": _object}, {}, slow=True),
        "call_service": PageVerb(sending.call, {"name": _text, "type": _text, "request": _object}, {}, slow=True),
    }  # fmt: skip


def _text(value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= MOST_TYPE:
        raise ValueError(f"must be a name of up to {MOST_TYPE} characters")
    return value


def _kind(value: Any) -> str:
    if value not in KINDS:
        raise ValueError(f"must be one of {', '.join(KINDS)}")
    return str(value)


def _object(value: Any) -> dict[str, Any]:
    if isinstance(value, dict):
        return value
    raise ValueError("must be an object of fields")
