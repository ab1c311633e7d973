"""The ports of the YARP network that concern topics, without those that YARP itself has joined to ROS 1."""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from bridge.adapters.ros1.environment import available, master_uri
from bridge.adapters.yarp.contents import Contents
from bridge.adapters.yarp.network import OWNER, PRESENCE, PortNames
from bridge.config.model import Config
from bridge.messages.definitions.names import is_ros1_name, is_ros2_name
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.os.ports.nested import LATCHED, PUBLISHER, NestedName
from yarp_compat.ports import text_client
from yarp_compat.ports.naming import NamingError, PortError
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.values import Vocab

if TYPE_CHECKING:
    from bridge.adapters.ros1_peers import XmlRpcClient

_log = logging.getLogger(__name__)

_ASK_SECONDS = 1.0
_PERIOD = 2.0
"""Seconds between looks at the master; where it does not answer, what was known holds."""

_YOUNG = 3.0
"""Seconds after ports came or went for which the master is asked at every look: it learns of them a moment later."""

_CARRIER = "tcpros"
"""What the ports of programs with YARP's support of ROS offer; others are at the master in name alone."""

_ROSOUT = "/rosout"
"""A node of every roscore, and no YARP port: a name server that knows where it is has asked the master."""


class Ros1Ports:
    """Finds the ports that YARP 3's own support of ROS has joined to ROS 1 already; one thread calls it.

    A ``yarpserver --ros`` registers the ports ``/topic@/node`` of its programs at a ROS 1 master, too, and these speak
    TCPROS with every node there (``RosNameSpace.cpp``, ``SubscriberOnSql.cpp``, ``Node.cpp`` of 3.9.1). Where our
    ROS 1 side is on that master, it carries their topics; what crossed by the YARP side as well would come twice.

    Args:
        config: says whether there is a ROS 1 side here, and which master it is on.
    """

    def __init__(self, config: Config, naming: NameClient) -> None:
        self._naming = naming
        self._caller = f"/{config.name}_yarp"
        self._config = config
        self._joined = False
        self._at_master: frozenset[str] = frozenset()
        self._offers: dict[PortContact, bool] = {}
        self._seen: frozenset[PortContact] = frozenset()
        self._due = self._young_until = 0.0
        self._found: frozenset[str] = frozenset()

    @cached_property
    def _master(self) -> XmlRpcClient | None:
        """A client of the master; most networks have no port that asks for it."""
        return _client(self._config)

    def among(self, contacts: Mapping[str, PortContact]) -> frozenset[str]:
        """Those of the registered ports that are ROS 1's; raises `NamingError`."""
        nested = {name: parts.node for name in contacts if (parts := NestedName.parse(name)).is_nested and parts.node}
        if not nested or self._master is None:
            return frozenset()
        from bridge.adapters.ros1_peers import Ros1Error  # and with it all of HTTP, 2 MB

        now, seen = time.monotonic(), frozenset(contacts[name] for name in nested)
        if seen != self._seen:
            self._seen, self._due, self._young_until = seen, now, now + _YOUNG
            self._offers = {contact: named for contact, named in self._offers.items() if contact in seen}
        if now >= self._due:
            try:
                self._ask(self._master, nested, contacts)
                self._due = 0.0 if now < self._young_until else now + _PERIOD
            except Ros1Error as err:
                _log.debug("ports of ROS 1 nodes on the YARP network: %s", err)
                self._due = now + _PERIOD
        there = {name for name in nested if self._joined or name in self._at_master}
        found = frozenset(name for name in there if self._speaks_ros(contacts[name]))
        if found - self._found:
            text = "%s: carried by the ROS 1 side, as the YARP name server has joined the network to its master"
            _log.info(text, ", ".join(sorted(found - self._found)))
        self._found = found
        return found

    def close(self) -> None:
        """End the conversation with the master."""
        if "_master" in self.__dict__ and self._master is not None:
            self._master.close()

    def _ask(self, master: XmlRpcClient, nested: Mapping[str, str], contacts: Mapping[str, PortContact]) -> None:
        """Learn which of the nodes the master has at the same number, and whether the name server asks this master."""
        nodes = sorted(set(nested.values()))
        rosout, *uris = master.calls([("lookupNode", (self._caller, node)) for node in (_ROSOUT, *nodes)])
        numbers = {node: _number(uri) for node, uri in zip(nodes, uris, strict=True)}
        # Numbers alone: for a loopback address the master is told the machine's name.
        own = {node for node in nodes if node in contacts and contacts[node].port == numbers[node]}
        self._at_master = frozenset(name for name, node in nested.items() if node in own)
        if (number := _number(rosout)) and _ROSOUT not in contacts:
            known = self._naming.query(_ROSOUT)
            self._joined = known is not None and (known.host, known.port) == (urlsplit(rosout).hostname, number)

    def _speaks_ros(self, contact: PortContact) -> bool:
        """Whether a port's program speaks TCPROS; assumed while it has not registered its carriers."""
        known = self._offers.get(contact)
        if known is None:
            offers = [str(value) for value in self._naming.get_property(contact.name, "offers")]
            if not offers:
                return True
            known = self._offers[contact] = _CARRIER in offers
        return known


def _client(config: Config) -> XmlRpcClient | None:
    """A client of the master that our ROS 1 side is on, None without such a side."""
    if config.ros1.enabled is False or (config.ros1.enabled == "auto" and available(config)):
        return None
    from bridge.adapters.ros1_peers import Ros1Error, XmlRpcClient

    try:
        return XmlRpcClient(master_uri(config, os.environ), _ASK_SECONDS)
    except Ros1Error:
        return None  # the ROS 1 side tells what is wrong with it


def _number(uri: object) -> int:
    """The port number of a node's address, 0 if it has none."""
    try:
        return urlsplit(uri).port or 0 if isinstance(uri, str) else 0
    except ValueError:
        return 0


_ANSWER_SECONDS = 2.0
"""Seconds that a port has to say whether it is latched: a program that does not answer holds up the others so long."""

_AGAIN = 2.0
"""Seconds after which a port that did not answer is tried again."""

_SOON = 0.3
"""The same the first time: it may have been registered and not listen yet."""

_TELLING = 3.0
"""Seconds after which a new port has made its type known."""


@dataclass(frozen=True, slots=True)
class NodePort:
    """A port that a YARP program opened as ``/topic@/node``.

    Attributes:
        type: ROS 2 name of its type, "" where it is not known.
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
class KnownPort:
    """What was learnt of a port that is registered, and since when."""

    contact: PortContact
    since: float
    made_by: MadeBy = MadeBy.UNKNOWN
    type: str = ""
    latched: bool = False
    asked: bool = False
    says_latched: bool = False
    read: bool = False


@dataclass(frozen=True, slots=True)
class YarpContext:
    """What the parts of the edge share.

    Attributes:
        owner: the id of this worker, by which its ports are marked.
        daemon: the daemon's name.
        names: what our ports are called.
        refused: called for a message or request that is refused: topic, reason, why.
        changed: called when a connection, a port or a worker came or went: the clerk looks again.
        limit: bytes of the longest message.
        ip: address to listen on, None for the usual one.
    """

    registry: Registry
    naming: NameClient
    owner: str
    daemon: str
    names: PortNames
    contents: Contents
    graph: YarpGraph
    refused: Callable[[str, str, str], None]
    changed: Callable[[], None]
    limit: int
    ip: str | None


class YarpGraph:
    """Follows the name server's list; one thread calls `update`, the others read what it left.

    Attributes:
        known: the ports that were looked at, by name.
    """

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self.known: dict[str, KnownPort] = {}
        self._dead: dict[str, tuple[PortContact, float]] = {}
        self._strangers: frozenset[str] = frozenset()
        self.contacts: Mapping[str, PortContact] = {}
        self.nodes: Sequence[NodePort] = ()
        self.ros1: frozenset[str] = frozenset()
        self.trouble: Mapping[str, str] = {}

    def update(
        self, naming: NameClient, contacts: Iterable[PortContact], peers: Iterable[str],
        ros1: frozenset[str] = frozenset(),
    ) -> None:  # fmt: skip
        """Update from the name server's list; ``peers`` are connected to ours, ``ros1`` are the ROS 1 side's."""
        self.contacts = {contact.name: contact for contact in contacts}
        self.ros1 = ros1
        peers = frozenset(peers)
        self._strangers = peers - self.contacts.keys()
        for name, known in list(self.known.items()):  # in place: connections' threads take out of it, too
            if self.contacts.get(name) != known.contact:
                self.known.pop(name, None)
        self._revive()
        nodes, trouble = [], dict[str, str]()
        for name in [*self.contacts, *peers]:
            nested = NestedName.parse(name) if "@" in name and name not in ros1 else None
            if nested is not None and nested.is_topic and name in self.contacts:
                known = self._look_at(naming, name)
                if known.made_by is MadeBy.NATIVE:
                    nodes.append(self._node(name, nested, known, trouble))
            elif name in peers and name in self.contacts:
                self._look_at(naming, name)
        self.nodes, self.trouble = nodes, trouble

    def forget(self, name: str) -> None:
        """Forget a port whose connection ended: under the same name another program may come."""
        self.known.pop(name, None)

    # -- who made a port -----------------------------------------------------------------------------------------------

    def made_by(self, name: str) -> MadeBy:
        """Who made a port. One that is not registered is native: bridges register theirs."""
        if name.startswith(PRESENCE):
            return MadeBy.MIDSPAN
        if name not in self.contacts:
            return MadeBy.NATIVE if name in self._strangers or not name.startswith("/") else MadeBy.UNKNOWN
        known = self.known.get(name)
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

    def _look_at(self, naming: NameClient, name: str) -> KnownPort:
        known = self.known.get(name)
        if known is None:
            known = self.known[name] = KnownPort(self.contacts[name], time.monotonic())
        if known.made_by is MadeBy.UNKNOWN:
            known.made_by = MadeBy.MIDSPAN if naming.get_property(name, OWNER) else MadeBy.NATIVE
        young = time.monotonic() - known.since < _TELLING
        if "@" in name and known.made_by is MadeBy.NATIVE and (young or not known.read):
            known.read = True
            self._ask(name, known)
            known.type = known.type or self._type_of(naming, known.contact)
            known.latched = known.says_latched or _is_true(naming.get_property(name, LATCHED))
        return known

    def _ask(self, name: str, known: KnownPort) -> None:
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
            answer = text_client.admin(known.contact, [Vocab("prop"), Vocab("get"), LATCHED], _ANSWER_SECONDS)
            known.says_latched = _is_true(answer)

    # -- topics --------------------------------------------------------------------------------------------------------

    def _node(self, name: str, nested: NestedName, known: KnownPort, trouble: dict[str, str]) -> NodePort:
        named, type_name = known.type, ""
        try:
            type_name = self._ros2(named) if named else ""
        except MessageTypeError as err:
            trouble[name] = f"{name}: {err}" + (f"; {err.cure}" if err.cure else "")
        return NodePort(name, nested.topic, nested.node, type_name, nested.role == PUBLISHER, known.latched)

    def _ros2(self, named: str) -> str:
        if is_ros2_name(named):
            return named
        if is_ros1_name(named):
            return self._registry.ros1_to_hub(named).target.name
        raise MessageTypeError(f"its type {named[:80]!r} is not a ROS type")

    @staticmethod
    def _type_of(naming: NameClient, contact: PortContact) -> str:
        """A port's type, from the name server or from the port itself."""
        named = naming.get_property(contact.name, "type")
        if named:
            return str(named[0])
        try:
            answer = text_client.admin(contact, [Vocab("prop"), Vocab("get"), contact.name], _ASK_SECONDS)
        except (PortError, NamingError):
            return ""
        return str(_find(_find(answer, "port"), "type") or "")


def _is_true(values: Sequence[Any]) -> bool:
    """Whether a property's first value is true, as YARP's programs write it."""
    return str(next(iter(values), "")).lower() in ("true", "1")


def _find(values: Any, key: str) -> Any:
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
