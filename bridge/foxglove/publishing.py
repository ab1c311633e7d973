"""What clients publish, on the hub: each channel that one advertises is a publisher for as long as it does.

Velocities go the way of the console's driving by hand (`bridge.web.verbs.hold`): on the base's own topic alone, one
client at a time, not faster than there, for 0.3 s after each message, and then zero once; so they also end with their
client.
"""

from __future__ import annotations

import json
import logging
import math
from abc import ABC, abstractmethod
from typing import Any

from bridge.config.sections.section import ROS2_NAME
from bridge.foxglove.events import Advertised, ClientMessage, Events
from bridge.foxglove.server import FoxgloveServer
from bridge.foxglove.visitors import Visitor, Visitors
from bridge.hub.errors import HubError
from bridge.hub.graph.tokens import TAPS, UNKNOWN_HASH
from bridge.hub.wire.qos import Qos
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.json import from_json
from bridge.messages.values import MessageReader
from bridge.modules.host import Host
from bridge.modules.hub_topics import Definitions
from bridge.routing.counters import Counters
from bridge.routing.limits import COMMAND_TYPES
from bridge.routing.rules import RuleSet
from bridge.web.verbs.hold import HandDriving
from navigation.messages import TWIST

_log = logging.getLogger("midspan.foxglove")

ENCODINGS = ("cdr", "json")
DEPTH = 10


class NotPublishedError(Exception):
    """A channel's messages are not published; the text says why."""


class UnknownYetError(NotPublishedError):
    """Nobody has told the type's definition yet; it is asked for."""


class PublishedChannel(ABC):
    """One channel of a client, on the worker's thread."""

    def __init__(self, channel: Advertised, visitor: Visitor | None) -> None:
        self.channel, self.visitor = channel, visitor
        self.counters = Counters()
        self.reason = ""  # nothing of it is published, for this reason

    @abstractmethod
    def send(self, message: ClientMessage) -> None:
        """Publish; raises `NotPublishedError`."""

    def close(self) -> None:  # noqa: B027 - most have nothing to give back
        """Publish no more."""


class RefusedChannel(PublishedChannel):
    """Publishes nothing; a route that waits for its definition is made anew."""

    def __init__(self, channel: Advertised, visitor: Visitor | None, reason: str, *, waits: bool) -> None:
        super().__init__(channel, visitor)
        self.reason, self.waits = reason, waits

    def send(self, message: ClientMessage) -> None:  # noqa: ARG002 - nothing of it
        """Count it."""
        self.counters.dropped("unknown" if self.waits else "held")


class Coder:
    """Makes CDR of a client's messages.

    Raises:
        UnknownYetError: the type's definition is asked for.
        NotPublishedError: there is no such type.
    """

    def __init__(self, host: Host, definitions: Definitions, channel: Advertised) -> None:
        self._registry = registry = host.node.registry
        self.type_name, self.type_hash = self._kind(host, definitions, channel)
        self._json = channel.encoding == "json"
        self._check = registry.hub_check(self.type_name, self.type_hash)
        self._schema = registry.schema(self.type_name, self.type_hash)

    def _kind(self, host: Host, definitions: Definitions, channel: Advertised) -> tuple[str, str]:
        """Name and hash: as others on the hub have it, else as it is installed here."""
        name = self._name(channel.type_name)
        graph = host.node.hub.graph
        ends = [*graph.subscriptions(channel.topic), *graph.publishers(channel.topic), *graph.endpoints()]
        hashes = (end.type_hash for end in ends if end.type_name == name and end.type_hash != UNKNOWN_HASH)
        if (type_hash := next(hashes, "")) and definitions.find(name, type_hash) is not None:
            return name, type_hash
        try:
            return name, self._registry.ros2(name).type_id
        except MessageTypeError as err:
            if type_hash:
                raise UnknownYetError(f"the definition of {name} is asked for on the hub") from None
            raise NotPublishedError(str(err)) from None

    def _name(self, spelled: str) -> str:
        if is_ros2_name(spelled):
            return spelled
        if not is_ros1_name(spelled):
            raise NotPublishedError(f"{spelled[:80]!r} is no type: write it as std_msgs/msg/String")
        try:
            return self._registry.ros1_to_hub(spelled).target.name
        except MessageTypeError:
            return spelled.replace("/", "/msg/")

    def cdr(self, data: bytes) -> bytes:
        """A message's bytes for the hub; raises `ConversionError`."""
        if not self._json:
            return self._check(data)
        try:
            value = json.loads(data)
        except (ValueError, RecursionError) as err:
            raise ConversionError(f"it is not JSON: {err}") from None
        if not isinstance(value, dict):
            raise ConversionError("it is no JSON object of fields")
        return from_json(self._registry, self.type_name, value, self.type_hash)

    def fields(self, cdr: bytes) -> dict[str, Any]:
        """Its values."""
        return MessageReader(self._schema, cdr).message()


class ClientTopic(PublishedChannel):
    """A topic that is no velocity. Nothing is kept for late joiners."""

    def __init__(self, host: Host, channel: Advertised, visitor: Visitor | None, coder: Coder) -> None:
        super().__init__(channel, visitor)
        self._coder = coder
        try:
            self._end = host.node.hub.publisher(channel.topic, coder.type_name, coder.type_hash, Qos(depth=DEPTH))
        except HubError as err:
            raise NotPublishedError(str(err)) from None

    def send(self, message: ClientMessage) -> None:
        """Publish as it is, once it has been checked."""
        try:
            cdr = self._coder.cdr(message.data)
            self._end.put(cdr)
        except (ConversionError, HubError) as err:
            self.counters.dropped("bad")
            raise NotPublishedError(str(err)) from None
        self.counters.crossed(len(cdr))

    def close(self) -> None:
        """Leave the hub."""
        self._end.close()


class ClientVelocity(PublishedChannel):
    """The base's velocity; a `bridge.web.verbs.hold.HandDriver`."""

    def __init__(self, driving: HandDriving, channel: Advertised, visitor: Visitor, coder: Coder) -> None:
        super().__init__(channel, visitor)
        self.who = visitor.who
        self._driving, self._coder = driving, coder
        self._refusal = ""

    def send(self, message: ClientMessage) -> None:
        """Drive so for a moment."""
        try:
            twist = self._coder.fields(self._coder.cdr(message.data))
        except ConversionError as err:
            self.counters.dropped("bad")
            raise NotPublishedError(str(err)) from None
        x, y, rotation = twist["linear"]["x"], twist["linear"]["y"], twist["angular"]["z"]
        if not all(map(math.isfinite, (x, y, rotation))):
            self.counters.dropped("bad")
            raise NotPublishedError("a velocity is a finite number")
        self._refusal = ""
        self._driving.hold(self, x, y, rotation, message.arrived)
        if self._refusal:
            self.counters.dropped("held")
            raise NotPublishedError(self._refusal)
        self.counters.crossed(len(message.data))

    def held(self, x: float, y: float, turn: float) -> None:
        """The app has no word for it."""

    def refuse(self, reason: str) -> None:
        """Why it may not drive."""
        self._refusal = reason

    def close(self) -> None:
        """Command zero where it drives."""
        self._driving.release(self)


class Publishing:
    """All channels of all clients. On the worker's thread."""

    def __init__(
        self, host: Host, server: FoxgloveServer, events: Events, visitors: Visitors, definitions: Definitions,
        driving: HandDriving,
    ) -> None:  # fmt: skip
        self._host, self._server, self._events, self._visitors = host, server, events, visitors
        self._definitions, self._driving = definitions, driving
        section = host.config.navigation
        self._velocity = section.velocity
        self._velocities = {section.velocity, *(planner.velocity for planner in section.others.values())} - {""}
        self._rules = RuleSet(host.config.rules)
        self._routes: dict[tuple[int, int], PublishedChannel] = {}
        self._warned: dict[tuple[int, int], str] = {}
        self._closed = False

    def refresh(self) -> None:
        """Take up what clients advertise, and publish what they said."""
        advertised, messages = self._events.pop_published()
        if self._closed:
            return
        for key, route in list(self._routes.items()):
            if advertised.get(key) is not route.channel:
                self._close(key)
        for key, channel in advertised.items():
            if key not in self._routes:
                self._open(key, channel)
        for message in messages:
            key = message.channel.client, message.channel.number
            if key in self._routes and self._routes[key].channel is message.channel:
                self._send(key, self._routes[key], message)

    def _open(self, key: tuple[int, int], channel: Advertised) -> None:
        visitor = self._visitors.visitor_of(channel.client)
        try:
            self._routes[key] = self._create(channel, visitor)
        except NotPublishedError as err:
            self._routes[key] = RefusedChannel(channel, visitor, str(err), waits=isinstance(err, UnknownYetError))
            self._warn(key, f"{channel.topic[:200]}: {err}")
        else:
            assert visitor is not None
            _log.info("%s publishes %s", visitor.who, channel.topic)

    def _create(self, channel: Advertised, visitor: Visitor | None) -> PublishedChannel:
        if visitor is None or not visitor.grant.may_drive:
            raise NotPublishedError("you may look, and not publish (foxglove.drive, or the role of your token)")
        if channel.encoding not in ENCODINGS:
            raise NotPublishedError(f"messages come as {' or '.join(ENCODINGS)}, not {channel.encoding[:40]!r}")
        if channel.topic.startswith(TAPS) or not ROS2_NAME.fullmatch(channel.topic):
            raise NotPublishedError(
                "it is no topic: begin it with a slash; letters, digits and underscores make its parts"
            )
        coder = Coder(self._host, self._definitions, channel)
        commands = self._rules.enter("zenoh", channel.topic, coder.type_name).priority == "command"
        if not (commands or coder.type_name in COMMAND_TYPES or channel.topic in self._velocities):
            return ClientTopic(self._host, channel, visitor, coder)
        if channel.topic != self._velocity or coder.type_name != TWIST:
            allowed = f"{self._velocity} as {TWIST}" if self._velocity else "no topic (navigation.velocity)"
            raise NotPublishedError(f"velocities are taken on {allowed}: nobody would stop the base behind this one")
        return ClientVelocity(self._driving, channel, visitor, coder)

    def _send(self, key: tuple[int, int], route: PublishedChannel, message: ClientMessage) -> None:
        try:
            route.send(message)
        except NotPublishedError as err:
            route.counters.failed(str(err))
            self._warn(key, f"{route.channel.topic}: {err}")

    def _warn(self, key: tuple[int, int], text: str) -> None:
        """Tell the clients, which the SDK can only do all at once; the same is not told again and again."""
        if self._warned.get(key) != text:
            self._warned[key] = text
            self._server.warn(text, f"publish-{key[0]}-{key[1]}")

    def _close(self, key: tuple[int, int]) -> None:
        self._routes.pop(key).close()
        if self._warned.pop(key, ""):
            self._server.clear_warning(f"publish-{key[0]}-{key[1]}")

    def tick(self) -> None:
        """Count rates; try again what waits for a definition."""
        for key, route in list(self._routes.items()):
            route.counters.tick()
            if isinstance(route, RefusedChannel) and route.waits:
                self._close(key)
                self._open(key, route.channel)

    def status(self) -> list[dict[str, Any]]:
        """What clients publish, as the status document has it."""
        return [
            {
                "topic": route.channel.topic[:255], "type": route.channel.type_name[:255], "end": "publisher",
                "by": route.visitor.who if route.visitor else "a stranger", "why": route.reason,
                **route.counters.as_dict(),
            }
            for route in self._routes.values()
        ]  # fmt: skip

    def close(self) -> None:
        """Stop what drives, withdraw all, and take up nothing more."""
        self._closed = True
        for key in list(self._routes):
            self._close(key)
