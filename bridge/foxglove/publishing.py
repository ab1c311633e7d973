"""Publishes clients' messages on the hub: each channel that a client advertises is a publisher while it is advertised.

Velocities use the console's manual driving (`bridge.web.verbs.hold`): only on the base's own topic, one client at a
time, within the console's speed limits, for 0.3 s after each message, then zero for a moment. So they also end when the
client disconnects.
"""

from __future__ import annotations

import json
import logging
import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

from typing_extensions import override

from bridge.client.errors import ClientError
from bridge.client.topics import Definitions
from bridge.client.types import ros2_name
from bridge.clock import steady
from bridge.config.sections.section import ROS2_NAME
from bridge.foxglove.events import Advertised, ClientMessage, Events
from bridge.foxglove.presses import Press, Presses
from bridge.foxglove.server import FoxgloveServer
from bridge.foxglove.status import ChannelStatus
from bridge.foxglove.visitors import Visitor, Visitors
from bridge.hub.errors import HubError
from bridge.hub.graph.tokens import TAPS, UNKNOWN_HASH
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.json import from_json
from bridge.messages.values import MessageReader
from bridge.messages.velocities import TWIST, VELOCITIES
from bridge.modules.host import Host
from bridge.routing.counters import Counters
from bridge.routing.limits import Priority
from bridge.routing.rules import RuleSet
from bridge.routing.stall import StallDetector
from bridge.web.verbs.hold import HandDriving

_log = logging.getLogger("midspan.foxglove")

ENCODINGS = ("cdr", "json")
DEPTH = 10  # the depth of the publishers' QoS

RELEASED_SECONDS = 1.5
"""A control counts as released after this time without a message. The app's panel sends one a second."""

STALL_SECONDS = 0.5
"""After a longer stall of this process, messages may have arrived that have not been read yet."""


class NotPublishedError(Exception):
    """A channel's messages are not published; the text is the reason."""


class UnknownYetError(NotPublishedError):
    """The type's definition is not known yet; it has been requested."""


class PublishedChannel(ABC):
    """One channel of a client, on the worker's thread."""

    def __init__(self, channel: Advertised, visitor: Visitor | None) -> None:
        self.channel, self.visitor = channel, visitor
        self.counters = Counters()
        self.reason = ""  # why messages are not published; "" if they are published

    @abstractmethod
    def send(self, message: ClientMessage) -> None:
        """Publish a message; raises `NotPublishedError`."""

    def close(self) -> None:  # noqa: B027 - most have nothing to release
        ...


class RefusedChannel(PublishedChannel):
    """Publishes nothing; a channel that ``waits`` for a definition is opened again."""

    def __init__(self, channel: Advertised, visitor: Visitor | None, reason: str, *, waits: bool) -> None:
        super().__init__(channel, visitor)
        self.reason, self.waits = reason, waits

    @override
    def send(self, message: ClientMessage) -> None:
        """Count the message as dropped."""
        self.counters.dropped("unknown" if self.waits else "held")


class Coder:
    """Converts a client's messages to CDR.

    Raises:
        UnknownYetError: the type's definition is not known yet, and has been requested.
        NotPublishedError: the type is unknown.
    """

    def __init__(self, host: Host, definitions: Definitions, channel: Advertised) -> None:
        self._registry = registry = host.node.registry
        self.type_name, self.type_hash = self._kind(host, definitions, channel)
        self._json = channel.encoding == "json"
        self._check = registry.hub_check(self.type_name, self.type_hash)
        self._schema = registry.schema(self.type_name, self.type_hash)

    def _kind(self, host: Host, definitions: Definitions, channel: Advertised) -> tuple[str, str]:
        """Return the type's name, and the hash of the version on the hub, or if unknown of the installed version."""
        try:
            name = ros2_name(self._registry, channel.type_name)
        except ClientError as err:
            raise NotPublishedError(str(err)) from None
        graph = host.node.hub.graph
        ends = [*graph.subscriptions(channel.topic), *graph.publishers(channel.topic), *graph.endpoints()]
        hashes = (end.type_hash for end in ends if end.type_name == name and end.type_hash != UNKNOWN_HASH)
        if (type_hash := next(hashes, "")) and definitions.find(name, type_hash) is not None:
            return name, type_hash
        try:
            return name, self._registry.ros2(name).type_id
        except MessageTypeError as err:
            if type_hash:
                raise UnknownYetError(f"the definition of {name} has been requested on the hub") from None
            raise NotPublishedError(str(err)) from None

    def cdr(self, data: bytes) -> bytes:
        """Return a message as CDR for the hub; raises `ConversionError`."""
        if not self._json:
            return self._check(data)
        try:
            value = json.loads(data)
        except (ValueError, RecursionError) as err:
            raise ConversionError(f"the message is not JSON: {err}") from None
        if not isinstance(value, dict):
            raise ConversionError("the message is not a JSON object of fields")
        return from_json(self._registry, self.type_name, value, self.type_hash)

    def fields(self, cdr: bytes) -> dict[str, Any]:
        """Return the message's fields."""
        return MessageReader(self._schema, cdr).message()


class ClientTopic(PublishedChannel):
    """A topic that carries no velocities. Nothing is stored for late joiners."""

    def __init__(self, host: Host, channel: Advertised, visitor: Visitor | None, coder: Coder) -> None:
        super().__init__(channel, visitor)
        self._coder = coder
        try:
            self._end = host.node.hub.publisher(channel.topic, coder.type_name, coder.type_hash, Qos(depth=DEPTH))
        except HubError as err:
            raise NotPublishedError(str(err)) from None

    @override
    def send(self, message: ClientMessage) -> None:
        """Publish the message: CDR unchanged after a check, JSON converted to CDR."""
        try:
            cdr = self._coder.cdr(message.data)
            self._end.put(cdr)
        except (ConversionError, HubError) as err:
            self.counters.dropped("bad")
            raise NotPublishedError(str(err)) from None
        self.counters.crossed(len(cdr))

    @override
    def close(self) -> None:
        self._end.close()


class ClientVelocity(PublishedChannel):
    """A client's channel for the base's velocity; implements `bridge.web.verbs.hold.HandDriver`.

    ``before`` is the person's press on an earlier channel, if it was not released: the app may have reconnected while
    the control is held. This channel then continues that press until the control is released here.
    """

    def __init__(
        self, driving: HandDriving, channel: Advertised, visitor: Visitor, coder: Coder, stalls: StallDetector,
        before: Press | None = None,
    ) -> None:  # fmt: skip
        super().__init__(channel, visitor)
        self.who, self.person = visitor.who, visitor.person
        self._driving, self._coder, self._stalls = driving, coder, stalls
        self._refusal = ""
        self.press = Press() if before is None else replace(before, arrived=steady())
        if self.press.refused:
            driving.block(self, self.press.pressed)

    @override
    def send(self, message: ClientMessage) -> None:
        """Drive at the message's velocity for a moment."""
        try:
            twist = self._coder.fields(self._coder.cdr(message.data))
        except ConversionError as err:
            self.counters.dropped("bad")
            raise NotPublishedError(str(err)) from None
        x, y, rotation = twist["linear"]["x"], twist["linear"]["y"], twist["angular"]["z"]
        if not all(map(math.isfinite, (x, y, rotation))):
            self.counters.dropped("bad")
            raise NotPublishedError("a velocity must be finite")
        self._refusal = ""
        press, moves = self.press, any((x, y, rotation))
        silent = message.arrived - press.arrived > RELEASED_SECONDS and not self._stalls.hung(STALL_SECONDS)
        if silent or not (press.held and moves):
            press.pressed, press.refused = message.arrived, False
        press.arrived, press.held = message.arrived, moves
        self._driving.hold(self, x, y, rotation, message.arrived, press.pressed)
        if self._refusal:
            self.counters.dropped("held")
            raise NotPublishedError(self._refusal)
        self.counters.crossed(len(message.data))

    def held(self, x: float, y: float, turn: float) -> None:
        """Do nothing: the app does not display the velocity."""

    def refuse(self, reason: str) -> None:
        """Store why the client may not drive."""
        self._refusal, self.press.refused = reason, True

    @override
    def close(self) -> None:
        """Command zero velocity if the client is driving."""
        self._driving.release(self)


class Publishing:
    """All channels of all clients. Used only on the worker's thread."""

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
        self._channels: dict[tuple[int, int], PublishedChannel] = {}
        self._warned: dict[tuple[int, int], str] = {}
        self._presses = Presses(host)
        self._stalls: StallDetector | None = None
        self._closed = False

    def refresh(self) -> None:
        """Open and close channels as clients advertise them, and publish their messages."""
        advertised, messages = self._events.pop_published()
        if self._closed:
            return
        for message in messages:  # the last messages of channels that close now
            key = message.channel.client, message.channel.number
            closing = self._channels.get(key)
            if closing is None or closing.channel is not message.channel or closing.channel is advertised.get(key):
                continue
            if not isinstance(closing, ClientVelocity):  # velocities end with their channel
                self._send(key, closing, message)
        for key, published in list(self._channels.items()):
            if advertised.get(key) is not published.channel:
                self._close(key)
        for key, channel in advertised.items():
            if key not in self._channels:
                self._open(key, channel)
        for message in messages:
            key = message.channel.client, message.channel.number
            if key in self._channels and self._channels[key].channel is message.channel:
                self._send(key, self._channels[key], message)

    def _open(self, key: tuple[int, int], channel: Advertised) -> None:
        visitor = self._visitors.visitor_of(channel.client)
        try:
            self._channels[key] = self._create(channel, visitor)
        except NotPublishedError as err:
            self._channels[key] = RefusedChannel(channel, visitor, str(err), waits=isinstance(err, UnknownYetError))
            self._warn(key, f"{channel.topic[:200]}: {err}")
        else:
            assert visitor is not None
            _log.info("%s publishes %s", visitor.who, channel.topic)

    def _create(self, channel: Advertised, visitor: Visitor | None) -> PublishedChannel:
        if visitor is None or not visitor.grant.may_drive:
            raise NotPublishedError("you may watch, but not publish (see foxglove.drive, or your token's role)")
        if channel.encoding not in ENCODINGS:
            raise NotPublishedError(f"the encoding must be {' or '.join(ENCODINGS)}, not {channel.encoding[:40]!r}")
        if channel.topic.startswith(TAPS) or not ROS2_NAME.fullmatch(channel.topic):
            raise NotPublishedError(
                "not a topic name: start it with a slash; its parts consist of letters, digits and underscores"
            )
        coder = Coder(self._host, self._definitions, channel)
        commands = self._rules.native_class(channel.topic, coder.type_name, latched=False) is Priority.COMMAND
        if not (commands or coder.type_name in VELOCITIES or channel.topic in self._velocities):
            return ClientTopic(self._host, channel, visitor, coder)
        if channel.topic != self._velocity or coder.type_name != TWIST:
            allowed = f"{self._velocity} as {TWIST}" if self._velocity else "no topic (navigation.velocity)"
            raise NotPublishedError(
                f"velocities are accepted only on {allowed}, because on other topics nothing would stop the base"
            )
        if self._stalls is None:
            self._stalls = StallDetector()
            self._stalls.start()
        before = self._presses.held_by(visitor.person)
        return ClientVelocity(self._driving, channel, visitor, coder, self._stalls, before)

    def _send(self, key: tuple[int, int], published: PublishedChannel, message: ClientMessage) -> None:
        try:
            published.send(message)
        except NotPublishedError as err:
            published.counters.failed(str(err))
            self._warn(key, f"{published.channel.topic}: {err}")
        if isinstance(published, ClientVelocity):
            self._presses.note(published.person, published.press)

    def _warn(self, key: tuple[int, int], text: str) -> None:
        """Warn all clients (the SDK cannot address a single one), unless the text is the same as before."""
        if self._warned.get(key) != text:
            self._warned[key] = text
            self._server.warn(text, f"publish-{key[0]}-{key[1]}")

    def _close(self, key: tuple[int, int]) -> None:
        self._channels.pop(key).close()
        if self._warned.pop(key, ""):
            self._server.clear_warning(f"publish-{key[0]}-{key[1]}")

    def tick(self) -> None:
        """Update rates, and retry channels that wait for a definition."""
        for key, published in list(self._channels.items()):
            published.counters.tick()
            if isinstance(published, RefusedChannel) and published.waits:
                self._close(key)
                self._open(key, published.channel)

    def status(self) -> list[ChannelStatus]:
        """Return the clients' channels, for the status document."""
        return [
            ChannelStatus(
                topic=published.channel.topic[:255], type=published.channel.type_name[:255], end="publisher",
                by=published.visitor.who if published.visitor else "unknown client", why=published.reason,
                **published.counters.as_dict(),
            )
            for published in self._channels.values()
        ]  # fmt: skip

    def close(self) -> None:
        """Stop the robot if a client drives it; close all channels, and open no new ones."""
        self._closed = True
        if self._stalls is not None:
            self._stalls.stop()
        for key in list(self._channels):
            self._close(key)
