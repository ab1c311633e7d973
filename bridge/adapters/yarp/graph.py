"""What is on the YARP network, as far as it concerns topics: ports of ROS-like names, and those that rules name."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bridge.adapters.base import MadeBy
from bridge.adapters.yarp.names import OWNER, PRESENCE
from bridge.messages.errors import MessageTypeError
from bridge.messages.names import is_ros1_name, is_ros2_name
from bridge.messages.registry import Registry
from yarp_compat.naming import connections, talk
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.errors import NamingError, PortError
from yarp_compat.os.nested import LATCHED, PUBLISHER, NestedName
from yarp_compat.wire.contact import Contact
from yarp_compat.wire.values import Vocab

_log = logging.getLogger(__name__)

_ASK_SECONDS = 1.0
_ANSWER_SECONDS = 2.0
"""Seconds that a port has to say whether it is latched: a program that does not answer holds up the others so long."""

_AGAIN = 2.0
"""Seconds after which a port that did not answer is tried again."""

_SOON = 0.3
"""The same the first time: it may have been registered and not listen yet."""

_TELLING = 3.0
"""Seconds after which a new port has told what it is."""


@dataclass(frozen=True, slots=True)
class NodePort:
    """A port that a YARP program opened as ``/topic@/node``.

    Attributes:
        type: ROS 2 name of its type, "" where it is not told.
        publishes: it writes; else it reads.
        latched: it sends its last message to whoever connects.
    """

    port: str
    topic: str
    node: str
    type: str
    publishes: bool
    latched: bool


@dataclass(slots=True)
class _Known:
    contact: Contact
    since: float
    made_by: MadeBy = MadeBy.UNKNOWN
    type: str = ""
    latched: bool = False
    asked: bool = False
    says_latched: bool = False
    read: bool = False


class Graph:
    """Follows the name server's list; one thread calls `update`, the others read what it left.

    Args:
        registry: of types.
    """

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._known: dict[str, _Known] = {}
        self._dead: dict[str, tuple[Contact, float]] = {}
        self._strangers: frozenset[str] = frozenset()
        self.contacts: Mapping[str, Contact] = {}
        self.nodes: Sequence[NodePort] = ()
        self.trouble: Mapping[str, str] = {}

    def update(self, naming: NameClient, contacts: Iterable[Contact], peers: Iterable[str]) -> None:
        """Take up a new list; ``peers``: ports that are connected to ours."""
        self.contacts = {contact.name: contact for contact in contacts}
        peers = frozenset(peers)
        self._strangers = peers - self.contacts.keys()
        for name, known in list(self._known.items()):  # in place: connections' threads take out of it, too
            if self.contacts.get(name) != known.contact:
                self._known.pop(name, None)
        self._revive()
        nodes, trouble = [], dict[str, str]()
        for name in [*self.contacts, *peers]:
            nested = NestedName.parse(name) if "@" in name else None
            if nested is not None and nested.is_topic and name in self.contacts:
                known = self._look_at(naming, name)
                if known.made_by is MadeBy.NATIVE:
                    nodes.append(self._node(name, nested, known, trouble))
            elif name in peers and name in self.contacts:
                self._look_at(naming, name)
        self.nodes, self.trouble = nodes, trouble

    def forget(self, name: str) -> None:
        """A port's connection ended: when it is there again, it may be another one."""
        self._known.pop(name, None)

    # -- who made a port -----------------------------------------------------------------------------------------------

    def made_by(self, name: str) -> MadeBy:
        """Who made a port; one that is not registered is no bridge's."""
        if name.startswith(PRESENCE):
            return MadeBy.MIDSPAN
        if name not in self.contacts:
            return MadeBy.NATIVE if name in self._strangers or not name.startswith("/") else MadeBy.UNKNOWN
        known = self._known.get(name)
        return MadeBy.UNKNOWN if known is None else known.made_by

    def is_there(self, name: str) -> bool:
        """Whether a port is registered and, as far as is known, alive."""
        return name in self.contacts and name not in self._dead

    def died(self, name: str) -> None:
        """A port that is registered cannot be reached."""
        contact = self.contacts.get(name)
        if contact is not None:
            self._dead[name] = contact, time.monotonic() + _SOON

    def _revive(self) -> None:
        now = time.monotonic()
        for name, (contact, again) in list(self._dead.items()):
            if self.contacts.get(name) != contact:
                del self._dead[name]
            elif now >= again:
                if connections.responds(contact, timeout=_ASK_SECONDS):
                    del self._dead[name]
                else:
                    self._dead[name] = contact, time.monotonic() + _AGAIN

    def _look_at(self, naming: NameClient, name: str) -> _Known:
        known = self._known.get(name)
        if known is None:
            known = self._known[name] = _Known(self.contacts[name], time.monotonic())
        if known.made_by is MadeBy.UNKNOWN:
            known.made_by = MadeBy.MIDSPAN if naming.get_property(name, OWNER) else MadeBy.NATIVE
        young = time.monotonic() - known.since < _TELLING
        if "@" in name and known.made_by is MadeBy.NATIVE and (young or not known.read):
            known.read = True
            self._ask(name, known)
            known.type = known.type or self._type_of(naming, known.contact)
            known.latched = known.says_latched or _is_true(naming.get_property(name, LATCHED))
        return known

    def _ask(self, name: str, known: _Known) -> None:
        """Ask a publisher itself whether it is latched, once.

        A port knows that before it listens. At the name server it stands only some time after, as no name server keeps
        what is set of a name that is not registered yet: a message that came in between would not be kept. A port that
        does not listen yet counts as not there, so that it is not connected before it was asked.
        """
        if known.asked or NestedName.parse(name).role != PUBLISHER:
            return
        if not connections.responds(known.contact, timeout=_ASK_SECONDS):
            self.died(name)
            return
        known.asked = True
        with contextlib.suppress(PortError):
            answer = talk.admin(known.contact, [Vocab("prop"), Vocab("get"), LATCHED], _ANSWER_SECONDS)
            known.says_latched = _is_true(answer)

    # -- topics --------------------------------------------------------------------------------------------------------

    def _node(self, name: str, nested: NestedName, known: _Known, trouble: dict[str, str]) -> NodePort:
        told, type_name = known.type, ""
        try:
            type_name = self._ros2(told) if told else ""
        except MessageTypeError as err:
            trouble[name] = f"{name}: {err}" + (f"; {err.cure}" if err.cure else "")
        return NodePort(name, nested.topic, nested.node, type_name, nested.role == PUBLISHER, known.latched)

    def _ros2(self, told: str) -> str:
        if is_ros2_name(told):
            return told
        if is_ros1_name(told):
            return self._registry.ros1_to_hub(told).target.name
        msg = f"its type {told[:80]!r} is no type of ROS"
        raise MessageTypeError(msg)

    @staticmethod
    def _type_of(naming: NameClient, contact: Contact) -> str:
        """A port's type as it tells at the name server, or when it is asked."""
        told = naming.get_property(contact.name, "type")
        if told:
            return str(told[0])
        try:
            answer = talk.admin(contact, [Vocab("prop"), Vocab("get"), contact.name], _ASK_SECONDS)
        except (PortError, NamingError):
            return ""
        return str(_find(_find(answer, "port"), "type") or "")


def _is_true(values: Sequence[Any]) -> bool:
    """Whether a property's first value says so, as YARP's programs write it."""
    return str(next(iter(values), "")).lower() in ("true", "1")


def _find(values: Any, key: str) -> Any:
    """What stands behind a key in YARP's lists of lists."""
    if isinstance(values, dict):
        return values.get(key)
    if not isinstance(values, list | tuple):
        return None
    for value in values:
        if isinstance(value, list | tuple) and len(value) == 2 and value[0] == key:
            return value[1]
        if isinstance(value, list | dict) and len(values) == 1:
            return _find(value, key)
    return None
