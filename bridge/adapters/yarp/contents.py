"""The configured contents of ports: for topics, and for the requests and replies of services."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bridge.config.sections.yarp import ServicePort as ServiceRule
from bridge.config.sections.yarp import TopicPort, YarpSection
from bridge.hub.endpoints.calls import CallError
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.yarp.bottle import RosBottle, ros1_schema
from bridge.messages.yarp.codec import Codec, Missing
from bridge.messages.yarp.contents import Content, Form
from bridge.messages.yarp.fields import BottleEntry, FieldsCodec
from bridge.routing.rules import glob_regex
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

OK, FAIL = Vocab("ok"), Vocab("fail")


class CallBottles:
    """Converts the calls of one service to Bottles and back. All methods are thread-safe.

    A reply without fields is ``[ok]``. The reply to a failed call is ``[fail]`` with the reason, and a received
    ``[fail]`` counts as an error, as in YARP's modules.

    Args:
        type_name: ROS 2 name of the service's type.
        type_hash: the type's hash, "" for this machine's definition.
        request: the entries of the request's Bottle; empty for all fields as nested lists.
        reply: the entries of the reply's Bottle; empty for all fields as nested lists.
        profile: the profile to write for peers whose profile is unknown.

    Raises:
        MessageTypeError: the type is unknown, or cannot be converted to this content.
    """

    def __init__(
        self, registry: Registry, type_name: str, type_hash: str, request: Sequence[BottleEntry],
        reply: Sequence[BottleEntry], profile: Profile,
    ) -> None:  # fmt: skip
        schemas = registry.service_schemas(type_name, type_hash)
        calls = registry.service_hub_to_ros1(type_name, type_hash)
        texts = calls.side.definition.partition("\n---\n")[::2]
        converts = ((calls.request_to_side, calls.request_to_hub), (calls.response_to_side, calls.response_to_hub))
        codecs: list[dict[Profile, Codec]] = []
        for schema, entries, text, (to_side, to_hub), part in zip(
            schemas, (request, reply), texts, converts, ("Request", "Response"), strict=True
        ):
            codecs.append({})
            for known in Profile:
                if entries:
                    codecs[-1][known] = FieldsCodec(schema, entries, known)
                else:
                    assert to_side is not None
                    assert to_hub is not None
                    codecs[-1][known] = RosBottle(ros1_schema(f"{calls.side.name}{part}", text), to_side, to_hub, known)
        self._request, self._reply = codecs
        self._profile = profile
        self._silent = not schemas[1].root.fields and not reply

    def request_to_yarp(self, cdr: bytes, profile: Profile | None) -> list[Buffer]:
        """Convert a request for a port with this profile; raises `ConversionError`."""
        return self._request[profile or self._profile].to_yarp(cdr).payload

    def request_to_hub(self, payload: Buffer, profile: Profile | None) -> tuple[bytes, Profile]:
        """Convert a port's request; return its CDR, and its profile, which is detected. Raises `ConversionError`."""
        likely = profile or self._profile
        first: ConversionError | None = None
        for known in (likely, Profile.YARP3 if likely is Profile.YARP4 else Profile.YARP4):
            try:
                return self._request[known].to_hub(payload, known, None), known
            except ConversionError as err:
                first = first or err
        assert first is not None
        raise first

    def reply_to_yarp(self, reply: bytes | CallError, profile: Profile | None) -> list[Buffer]:
        """Convert a reply or error for the calling port; raises `ConversionError`."""
        used = profile or self._profile
        if isinstance(reply, CallError):
            return [binary.encode([FAIL, str(reply)], used)]
        return [binary.encode([OK], used)] if self._silent else self._reply[used].to_yarp(reply).payload

    def reply_to_hub(self, payload: Buffer, profile: Profile | None) -> bytes:
        """Convert a port's reply; raises `ConversionError`, or `CallError` if the port reports a failure."""
        try:
            values = binary.decode(bytes(payload), profile)
        except WireError:
            values = []
        if values and values[0] == FAIL and isinstance(values[0], Vocab):
            reason = " ".join(str(value) for value in values[1:])
            raise CallError(reason or "the port replied [fail]")
        if self._silent:
            payload = binary.encode([], profile or self._profile)
        return self._reply[profile or self._profile].to_hub(payload, profile, None)


BOTTLE = Content()


@dataclass(frozen=True, slots=True)
class ForeignPort:
    """A port of a YARP program, named by a rule; ``carrier`` is "" for the default."""

    port: str
    topic: str
    type: str
    content: Content
    profile: Profile | None
    carrier: str
    latched: bool


class Contents:
    """The rules by topic and port, and their converters; ``now_ns`` returns the stamp for messages without a stamp."""

    now_ns: Callable[[], int] = staticmethod(time.time_ns)

    def __init__(self, section: YarpSection, registry: Registry) -> None:
        self.profile = Profile(section.profile)
        self._section, self._registry = section, registry
        self._own = [(glob_regex(rule.topic), rule) for rule in section.topics if rule.port is None]
        foreign = [rule for rule in section.topics if rule.port is not None]
        self.incoming = [self._foreign(rule) for rule in foreign if rule.direction == "in"]
        self.outgoing = [self._foreign(rule) for rule in foreign if rule.direction == "out"]
        self.declared: Sequence[TopicPort] = [rule for _, rule in self._own if rule.brings]
        self._services = [(glob_regex(rule.service), rule) for rule in section.services if rule.port is None]
        self.port_rules = [rule for rule in section.services if rule.port is not None]
        self._codecs: dict[tuple[str, str, Content, Profile], Codec] = {}
        self._lock = threading.Lock()

    def _foreign(self, rule: TopicPort) -> ForeignPort:
        assert rule.port is not None
        content = self._content(rule)
        profile = Profile(rule.profile) if rule.profile else None
        return ForeignPort(rule.port, rule.topic, rule.type or "", content, profile, rule.carrier or "", rule.latched)

    def _content(self, rule: TopicPort) -> Content:
        return Content(
            rule.form or self._section.as_,
            tuple(BottleEntry.parse(entry) for entry in rule.fields),
            Profile(rule.profile or self._section.profile),
            Missing(rule.frame, rule.child_frame, rule.joints),
        )

    def of_topic(self, topic: str) -> Content:
        """Return the content of a topic's ports."""
        rule = next((rule for pattern, rule in self._own if pattern.fullmatch(topic)), None)
        return Content(self._section.as_, profile=self.profile) if rule is None else self._content(rule)

    def served_by(self, service: str) -> ServiceRule | None:
        """Return the rule that offers a YARP program's port as this service; None if there is none."""
        return next((rule for rule in self.port_rules if rule.service == service), None)

    def bottles(self, service: str, type_name: str, type_hash: str) -> CallBottles:
        """Return the converter of a service's calls; raises `MessageTypeError`."""
        request, reply = self.of_service(service)
        return CallBottles(self._registry, type_name, type_hash, request.fields, reply.fields, self.profile)

    def of_service(self, service: str) -> tuple[Content, Content]:
        """Return the contents of the requests and of the replies of a service's RPC port."""
        rule = self.served_by(service) or next(
            (rule for pattern, rule in self._services if pattern.fullmatch(service)), None
        )
        request, reply = ((), ()) if rule is None else (rule.request, rule.reply)
        return self._chosen(request), self._chosen(reply)

    def _chosen(self, fields: Sequence[int | float | str]) -> Content:
        form: Form = "fields" if fields else "bottle"
        return Content(form, tuple(BottleEntry.parse(entry) for entry in fields), self.profile)

    def latched(self, topic: str) -> bool:
        """Return whether a topic's last message from YARP is cached for late joiners."""
        return any(rule.latched for pattern, rule in self._own if pattern.fullmatch(topic))

    def codec(self, content: Content, type_name: str, type_hash: str, profile: Profile) -> Codec:
        """Return the converter of a type; raises `MessageTypeError`."""
        key = (type_name, type_hash, content, profile)
        with self._lock:
            known = self._codecs.get(key)
            if known is None:
                known = Content(content.form, content.fields, profile, content.missing).codec(
                    self._registry, type_name, type_hash
                )
                known.now_ns = self.now_ns
                self._codecs[key] = known
            return known
