"""What a page sends from a form: one message of a topic, one call of a service."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import OrderedDict
from functools import partial
from typing import Any

from bridge.cli.client import CliClient
from bridge.cli.graph.caller import ServiceCaller
from bridge.cli.messages import Types, ros2_spelling
from bridge.config.model import Config
from bridge.config.sections.section import ROS2_NAME
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.graph.tokens import TAPS, EndpointKind
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import split
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.json import from_json
from bridge.modules.host import Host
from bridge.routing.limits import COMMAND_TYPES, RateLimit
from bridge.routing.rules import RuleSet
from bridge.web.feeds.definitions import KINDS, definition
from bridge.web.feeds.topics import cut
from bridge.web.verbs.verbs import PageVerb, VerbError

MOST_RATE = 5.0
"""Messages a second of all pages together."""

MOST_TYPE = 255
CALL_SECONDS = 15.0
KEEP_SECONDS = 60.0
"""A topic's publisher stays for so long, so that the next message need not wait until it is known."""

_MOST_PUBLISHERS = 8
_MATCH_SECONDS = 2.0
_SETTLE_SECONDS = 1.0
_POLL_SECONDS = 0.02
_END_SECONDS = 0.5


class Sending:
    """Publishes and calls. All methods wait, but for `close`; not to be called on the module's thread."""

    def __init__(self, host: Host, config: Config, client: CliClient, types: Types) -> None:
        self._host, self._client, self._types = host, client, types
        section = config.navigation
        self._velocities = {section.velocity, *(planner.velocity for planner in section.others.values())} - {""}
        self._rules = RuleSet(config.rules)
        self._limit = RateLimit(MOST_RATE)
        self._lock = threading.Lock()
        self._publishers: OrderedDict[tuple[str, str], tuple[HubPublisher, float]] = OrderedDict()

    def publish(self, topic: str, type: str, message: dict[str, Any]) -> str:  # noqa: A002 - the protocol's name
        """Publish one message, once; raises `VerbError` or `CliError` with why not."""
        name = self._types.name(type)
        reason = self._refusal(topic, name)
        if reason:
            raise VerbError(reason)
        type_hash = self._types.hash_of(name)
        try:
            cdr = from_json(self._types.registry, name, message)
        except (ConversionError, MessageTypeError) as err:
            raise VerbError(f"{name}: {err}") from None
        with self._lock:
            if not self._limit.passes():
                raise VerbError(f"at most {MOST_RATE:g} messages a second are published from pages; press again")
            publisher = self._publisher(topic, name, type_hash)
            publisher.put(cdr)
            received = publisher.matched()
        return f"published on {topic}" if received else f"published on {topic}, and nobody on the hub listens to it"

    def _refusal(self, topic: str, type_name: str) -> str:
        if topic.startswith(TAPS) or not ROS2_NAME.fullmatch(topic):
            return f"{topic[:80]!r} is no topic: begin it with a slash; letters, digits and underscores make its parts"
        commands = self._rules.enter("zenoh", topic, type_name).priority == "command"
        if commands or type_name in COMMAND_TYPES or topic in self._velocities:
            return (
                f"velocities are not sent from a form, since nobody would stop the base behind {topic}: drive by hand"
                " in the view Drive, which commands zero as you let go"
            )
        return ""

    def _publisher(self, topic: str, name: str, type_hash: str) -> HubPublisher:
        """The topic's publisher, known to who listens; under the lock."""
        now, key = time.monotonic(), (topic, name)
        if key in self._publishers:
            publisher, _ = self._publishers.pop(key)
        else:
            publisher = self._client.hub.publisher(topic, name, type_hash, Qos(depth=1))
            self._await_listeners(publisher)
        self._publishers[key] = publisher, now
        while len(self._publishers) > _MOST_PUBLISHERS:
            self._publishers.popitem(last=False)[1][0].close()
        self._host.loop.post(partial(self._host.loop.after, KEEP_SECONDS + 1.0, self._tidy))
        return publisher

    def _await_listeners(self, publisher: HubPublisher) -> None:
        end = time.monotonic() + _MATCH_SECONDS
        while not publisher.matched() and time.monotonic() < end:
            time.sleep(_POLL_SECONDS)
        if publisher.matched():
            # the workers listen; those on their sides are still connecting to the publishers that the workers made
            time.sleep(_SETTLE_SECONDS)

    def _tidy(self) -> None:
        if not self._lock.acquire(blocking=False):
            return  # somebody publishes, and looks again later
        try:
            late = time.monotonic() - KEEP_SECONDS
            for key in [key for key, (_, used) in self._publishers.items() if used < late]:
                self._publishers.pop(key)[0].close()
        finally:
            self._lock.release()

    def call(self, name: str, type: str, request: dict[str, Any]) -> dict[str, Any]:  # noqa: A002
        """Call a service once; its reply. Raises `VerbError` or `CliError`."""
        if not ROS2_NAME.fullmatch(name) or split(name)[1]:
            raise VerbError(f"{name[:80]!r} is no service")
        with contextlib.closing(ServiceCaller(self._client, self._types, name, ros2_spelling(type, "srv"))) as caller:
            reply: dict[str, Any] = cut(caller.ask(request, CALL_SECONDS))
        return reply

    def close(self) -> None:
        """Withdraw the publishers."""
        if self._lock.acquire(timeout=_END_SECONDS):  # else one is being sent, and ends with the session
            while self._publishers:
                self._publishers.popitem()[1][0].close()
            self._lock.release()


def list_services(client: CliClient) -> list[dict[str, Any]]:
    """The value of ``services``: what is served or called on the hub, without the parts of actions."""
    services: dict[tuple[str, str], dict[str, Any]] = {}
    ends = {EndpointKind.SERVER: "servers", EndpointKind.CLIENT: "clients"}
    for end in client.hub.graph.endpoints():
        if end.kind in ends and not end.topic.startswith(TAPS) and not split(end.topic)[1]:
            empty = {"service": end.topic, "type": end.type_name, "servers": 0, "clients": 0}
            services.setdefault((end.topic, end.type_name), empty)[ends[end.kind]] += 1
    return [services[key] for key in sorted(services)]


def sending_verbs(sending: Sending, types: Types) -> dict[str, PageVerb]:
    """The verbs by name."""
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
        raise ValueError(f"is a name of up to {MOST_TYPE} characters")
    return value


def _kind(value: Any) -> str:
    if value not in KINDS:
        raise ValueError(f"is one of {', '.join(KINDS)}")
    return str(value)


def _object(value: Any) -> dict[str, Any]:
    if isinstance(value, dict):
        return value
    raise ValueError("is an object of fields")
