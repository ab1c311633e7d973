"""The graph of a YARP network: its ports for topics, without the ports that YARP itself has joined to ROS 1."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from bridge.adapters.ros1.environment import master_uri
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
"""Seconds between queries of the master; if it does not answer, the last result stays valid."""

_YOUNG = 3.0
"""For this many seconds after ports change, each update queries the master, which lists the ports a moment later."""

_CARRIER = "tcpros"
"""A carrier that ports of programs with YARP's ROS support offer; other ports are only registered at the master."""

_ROSOUT = "/rosout"
"""A node of every roscore, but no YARP port; a name server that resolves this name has queried the master."""


class Ros1Ports:
    """Detects the ports that YARP 3's own ROS support has joined to ROS 1. Used on one thread.

    A ``yarpserver --ros`` also registers the ports ``/topic@/node`` of its programs at a ROS 1 master, and they connect
    to all ROS 1 nodes over TCPROS (``RosNameSpace.cpp``, ``SubscriberOnSql.cpp``, ``Node.cpp`` of 3.9.1). If Midspan's
    ROS 1 side is on that master, it bridges the topics of these ports; if the YARP side bridged them, too, messages
    would arrive twice.

    Args:
        config: determines whether this daemon has a ROS 1 side, and the address of its master.
    """

    def __init__(self, config: Config, naming: NameClient) -> None:
        self._naming = naming
        self._caller = f"/{config.name}_yarp"
        self._config = config
        self._server_uses_master = False
        self._at_master: frozenset[str] = frozenset()
        self._offers: dict[PortContact, bool] = {}
        self._seen: frozenset[PortContact] = frozenset()
        self._due = self._young_until = 0.0
        self._ports: frozenset[str] = frozenset()

    @cached_property
    def _master(self) -> XmlRpcClient | None:
        """A client of the master, created on demand because most networks do not need it."""
        return _client(self._config)

    def select(self, contacts: Mapping[str, PortContact]) -> frozenset[str]:
        """Return the registered ports that are joined to ROS 1; raises `NamingError`."""
        nested = {name: parts.node for name in contacts if (parts := NestedName.parse(name)).is_nested and parts.node}
        if not nested or self._master is None:
            return frozenset()
        from bridge.adapters.ros1_peers import Ros1Error  # imports the HTTP modules, 2 MB

        now, seen = time.monotonic(), frozenset(contacts[name] for name in nested)
        if seen != self._seen:
            self._seen, self._due, self._young_until = seen, now, now + _YOUNG
            self._offers = {contact: named for contact, named in self._offers.items() if contact in seen}
        if now >= self._due:
            try:
                self._query(self._master, nested, contacts)
                self._due = 0.0 if now < self._young_until else now + _PERIOD
            except Ros1Error as err:
                _log.debug("ports of ROS 1 nodes on the YARP network: %s", err)
                self._due = now + _PERIOD
        candidates = {name for name in nested if self._server_uses_master or name in self._at_master}
        joined = frozenset(name for name in candidates if self._supports_tcpros(contacts[name]))
        if joined - self._ports:
            text = "%s: bridged by the ROS 1 side, because the YARP name server has joined the network to its master"
            _log.info(text, ", ".join(sorted(joined - self._ports)))
        self._ports = joined
        return joined

    def close(self) -> None:
        if "_master" in self.__dict__ and self._master is not None:
            self._master.close()

    def _query(self, master: XmlRpcClient, nested: Mapping[str, str], contacts: Mapping[str, PortContact]) -> None:
        """Query which nodes the master lists with the same port number, and whether the name server uses the master."""
        nodes = sorted(set(nested.values()))
        rosout, *uris = master.calls([("lookupNode", (self._caller, node)) for node in (_ROSOUT, *nodes)])
        numbers = {node: _number(uri) for node, uri in zip(nodes, uris, strict=True)}
        # Only port numbers are compared, because the master gets the machine's name in place of a loopback address.
        same = {node for node in nodes if node in contacts and contacts[node].port == numbers[node]}
        self._at_master = frozenset(name for name, node in nested.items() if node in same)
        if (number := _number(rosout)) and _ROSOUT not in contacts:
            known = self._naming.query(_ROSOUT)
            self._server_uses_master = known is not None and (known.host, known.port) == (
                urlsplit(rosout).hostname,
                number,
            )

    def _supports_tcpros(self, contact: PortContact) -> bool:
        """Return whether a port's program supports TCPROS; assume so until it has registered its carriers."""
        known = self._offers.get(contact)
        if known is None:
            offers = [str(value) for value in self._naming.get_property(contact.name, "offers")]
            if not offers:
                return True
            known = self._offers[contact] = _CARRIER in offers
        return known


def _client(config: Config) -> XmlRpcClient | None:
    """Return a client of the ROS 1 side's master, None without a ROS 1 side."""
    if config.ros1.enabled is False:
        return None
    from bridge.adapters.ros1_peers import Ros1Error, XmlRpcClient

    try:
        return XmlRpcClient(master_uri(config, os.environ), _ASK_SECONDS)
    except Ros1Error:
        return None  # the ROS 1 side reports the error


def _number(uri: object) -> int:
    """Return the port number of a node's address, 0 if it has none."""
    try:
        return urlsplit(uri).port or 0 if isinstance(uri, str) else 0
    except ValueError:
        return 0


_ANSWER_SECONDS = 2.0
"""Seconds for a port to answer whether it is latched; a program that does not answer delays the others."""

_RETRY = 2.0
"""Seconds before a port that did not answer is queried again."""

_FIRST_RETRY = 0.3
"""Seconds before the first retry: a registered port may not listen yet."""

_ANNOUNCE_SECONDS = 3.0
"""Seconds within which a new port announces its type."""

_READ_AGAIN = 10.0
"""Seconds between later attempts to read the type of a port without one; its program may have stalled."""


@dataclass(frozen=True, slots=True)
class NodePort:
    """A port that a YARP program opened as ``/topic@/node``.

    Attributes:
        type: the ROS 2 name of the port's type, "" if unknown.
        publishes: whether the port writes messages; otherwise it reads them.
        latched: whether the port sends its last message to late joiners.
    """

    port: str
    topic: str
    node: str
    type: str
    publishes: bool
    latched: bool


@dataclass(slots=True)
class KnownPort:
    """The known facts about a registered port.

    ``since`` is when it was first listed, or began to listen; ``queried``: it was asked whether it is latched, with
    the answer in ``announces_latched``; ``read`` is when its properties were last read from the name server.
    """

    contact: PortContact
    since: float
    made_by: MadeBy = MadeBy.UNKNOWN
    type: str = ""
    latched: bool = False
    queried: bool = False
    announces_latched: bool = False
    read: float = -math.inf


@dataclass(frozen=True, slots=True)
class YarpContext:
    """The objects that the parts of the adapter share.

    Attributes:
        owner: the id of this worker, which marks its ports.
        daemon: the daemon's name.
        names: the names of Midspan's ports.
        refused: called for each refused message or request: topic, reason, explanation.
        changed: called when connections, ports or workers change; wakes up the name-server thread.
        limit: the maximum message size in bytes.
        ip: the address to listen on, None for the default.
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
    """The ports in the name server's list; one thread calls `update`, and others read the result.

    Attributes:
        known: the inspected ports, by name.
    """

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self.known: dict[str, KnownPort] = {}
        self._unreachable: dict[str, tuple[PortContact, float]] = {}
        self._unregistered: frozenset[str] = frozenset()
        self.contacts: Mapping[str, PortContact] = {}
        self.nodes: Sequence[NodePort] = ()
        self.ros1: frozenset[str] = frozenset()
        self.trouble: Mapping[str, str] = {}

    def update(
        self, naming: NameClient, contacts: Iterable[PortContact], peers: Iterable[str],
        ros1: frozenset[str] = frozenset(),
    ) -> None:  # fmt: skip
        """Read the name server's list; ``peers`` are connected to Midspan's ports, ``ros1`` are joined to ROS 1."""
        self.contacts = {contact.name: contact for contact in contacts}
        self.ros1 = ros1
        peers = frozenset(peers)
        self._unregistered = peers - self.contacts.keys()
        for name, known in list(self.known.items()):  # in place, because connection threads remove items, too
            if self.contacts.get(name) != known.contact:
                self.known.pop(name, None)
        self._check_unreachable()
        nodes, trouble = [], dict[str, str]()
        for name in [*self.contacts, *peers]:
            nested = NestedName.parse(name) if "@" in name and name not in ros1 else None
            if nested is not None and nested.is_topic and name in self.contacts:
                known = self._inspect(naming, name)
                if known.made_by is MadeBy.NATIVE:
                    nodes.append(self._node(name, nested, known, trouble))
            elif name in peers and name in self.contacts:
                self._inspect(naming, name)
        self.nodes, self.trouble = nodes, trouble

    def discard(self, name: str) -> None:
        """Discard the facts about a port whose connection ended, because another program may reuse its name."""
        self.known.pop(name, None)

    # -- who made a port -----------------------------------------------------------------------------------------------

    def made_by(self, name: str) -> MadeBy:
        """Return who created a port.

        A peer that is not in the name server's list is native, because Midspan registers its ports.
        """
        if name.startswith(PRESENCE):
            return MadeBy.MIDSPAN
        if name not in self.contacts:
            return MadeBy.NATIVE if name in self._unregistered or not name.startswith("/") else MadeBy.UNKNOWN
        known = self.known.get(name)
        return MadeBy.UNKNOWN if known is None else known.made_by

    def is_present(self, name: str) -> bool:
        """Return whether a port is registered and not known to be unreachable."""
        return name in self.contacts and name not in self._unreachable

    def mark_unreachable(self, name: str) -> None:
        """Mark a registered port as unreachable."""
        contact = self.contacts.get(name)
        if contact is not None:
            self._unreachable[name] = contact, time.monotonic() + _FIRST_RETRY

    def _check_unreachable(self) -> None:
        now = time.monotonic()
        for name, (contact, again) in list(self._unreachable.items()):
            if self.contacts.get(name) != contact:
                del self._unreachable[name]
            elif now >= again:
                if connections.responds(contact, timeout=_ASK_SECONDS):
                    del self._unreachable[name]
                    if (known := self.known.get(name)) is not None and not known.queried:
                        known.since = time.monotonic()  # it was registered long before it listened
                else:
                    self._unreachable[name] = contact, time.monotonic() + _RETRY

    def _inspect(self, naming: NameClient, name: str) -> KnownPort:
        known = self.known.get(name)
        if known is None:
            known = self.known[name] = KnownPort(self.contacts[name], time.monotonic())
        if known.made_by is MadeBy.UNKNOWN:
            known.made_by = MadeBy.MIDSPAN if naming.get_property(name, OWNER) else MadeBy.NATIVE
        now = time.monotonic()
        young = now - known.since < _ANNOUNCE_SECONDS
        late = not known.type and name not in self._unreachable and now - known.read >= _READ_AGAIN
        if "@" in name and known.made_by is MadeBy.NATIVE and (young or late):
            known.read = now
            self._query_latched(name, known)
            known.type = known.type or self._type_of(naming, known.contact)
            known.latched = known.announces_latched or _is_true(naming.get_property(name, LATCHED))
        return known

    def _query_latched(self, name: str, known: KnownPort) -> None:
        """Ask a publisher once whether it is latched.

        The port has this property before it listens. The name server gets the property only later, because it stores
        none for unregistered names; a message received in between would not be cached. A port that does not listen yet
        is marked as unreachable, so that it is not connected before it has been asked.
        """
        if known.queried or NestedName.parse(name).role != PUBLISHER:
            return
        if not connections.responds(known.contact, timeout=_ASK_SECONDS):
            self.mark_unreachable(name)
            return
        known.queried = True
        with contextlib.suppress(PortError):
            answer = text_client.admin(known.contact, [Vocab("prop"), Vocab("get"), LATCHED], _ANSWER_SECONDS)
            known.announces_latched = _is_true(answer)

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
        """Return a port's type, from the name server or from the port itself."""
        named = naming.get_property(contact.name, "type")
        if named:
            return str(named[0])
        try:
            answer = text_client.admin(contact, [Vocab("prop"), Vocab("get"), contact.name], _ASK_SECONDS)
        except (PortError, NamingError):
            return ""
        return str(_find(_find(answer, "port"), "type") or "")


def _is_true(values: Sequence[Any]) -> bool:
    """Return whether a property's first value is true, as YARP programs write it."""
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
