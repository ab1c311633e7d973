"""What the configuration says of topics and ports, made ready for use."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bridge.adapters.yarp.call_bottles import CallBottles
from bridge.config.sections.yarp import Service as ServiceRule
from bridge.config.sections.yarp import Topic, YarpSection
from bridge.messages.registry import Registry
from bridge.messages.yarp.codec import Codec
from bridge.messages.yarp.contents import Content, Form
from bridge.messages.yarp.fields import Entry
from bridge.messages.yarp.natural.kind import Missing
from bridge.routing.patterns import glob_regex
from yarp_compat.wire.profile import Profile

BOTTLE = Content()


@dataclass(frozen=True, slots=True)
class ForeignPort:
    """A port of a YARP program that a rule names.

    Attributes:
        carrier: "" for the usual one.
    """

    port: str
    topic: str
    type: str
    content: Content
    profile: Profile | None
    carrier: str
    latched: bool


class Contents:
    """The rules, by topic and port; and the converters that they need.

    Attributes:
        now_ns: the time of messages that come without one.
    """

    now_ns: Callable[[], int] = staticmethod(time.time_ns)

    def __init__(self, section: YarpSection, registry: Registry) -> None:
        self.profile = Profile(section.profile)
        self.generations = section.generations()
        self._section, self._registry = section, registry
        self._own = [(glob_regex(rule.topic), rule) for rule in section.topics if rule.port is None]
        foreign = [rule for rule in section.topics if rule.port is not None]
        self.incoming = [self._foreign(rule) for rule in foreign if rule.direction == "in"]
        self.outgoing = [self._foreign(rule) for rule in foreign if rule.direction == "out"]
        self.declared: Sequence[Topic] = [rule for _, rule in self._own if rule.brings]
        self._services = [(glob_regex(rule.service), rule) for rule in section.services if rule.port is None]
        self.called = [rule for rule in section.services if rule.port is not None]
        self._codecs: dict[tuple[str, str, Content, Profile], Codec] = {}
        self._lock = threading.Lock()

    def _foreign(self, rule: Topic) -> ForeignPort:
        assert rule.port is not None
        content = self._content(rule)
        profile = Profile(rule.profile) if rule.profile else None
        return ForeignPort(rule.port, rule.topic, rule.type or "", content, profile, rule.carrier or "", rule.latched)

    def _content(self, rule: Topic) -> Content:
        return Content(
            rule.form or self._section.as_,
            tuple(Entry.parse(entry) for entry in rule.fields),
            Profile(rule.profile or self._section.profile),
            Missing(rule.frame, rule.child_frame, rule.joints),
        )

    def of(self, topic: str) -> Content:
        """What the ports of a topic carry."""
        rule = next((rule for pattern, rule in self._own if pattern.fullmatch(topic)), None)
        return Content(self._section.as_, profile=self.profile) if rule is None else self._content(rule)

    def served_by(self, service: str) -> ServiceRule | None:
        """The rule by which a port of a YARP program is a service; None where there is none."""
        return next((rule for rule in self.called if rule.service == service), None)

    def bottles(self, service: str, type_name: str, type_hash: str) -> CallBottles:
        """The converter of a service's calls; raises `MessageTypeError`."""
        request, reply = self.of_service(service)
        return CallBottles(self._registry, type_name, type_hash, request.fields, reply.fields, self.profile)

    def of_service(self, service: str) -> tuple[Content, Content]:
        """What the RPC port of a service carries: as requests, and as replies."""
        rule = self.served_by(service) or next(
            (rule for pattern, rule in self._services if pattern.fullmatch(service)), None
        )
        request, reply = ((), ()) if rule is None else (rule.request, rule.reply)
        return self._chosen(request), self._chosen(reply)

    def _chosen(self, fields: Sequence[int | float | str]) -> Content:
        form: Form = "fields" if fields else "bottle"
        return Content(form, tuple(Entry.parse(entry) for entry in fields), self.profile)

    def latched(self, topic: str) -> bool:
        """Whether the last message from YARP is kept for late joiners."""
        return any(rule.latched for pattern, rule in self._own if pattern.fullmatch(topic))

    def codec(self, content: Content, type_name: str, type_hash: str, profile: Profile) -> Codec:
        """The converter of a type; raises `MessageTypeError`."""
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
