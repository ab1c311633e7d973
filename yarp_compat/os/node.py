"""ROS topics from YARP code: `Node`, `Publisher`, `Subscriber`, on ordinary ports named ``/topic+@/node``.

No ROS library is needed: a Midspan daemon on the same YARP network sees such a port at the name server and joins it
with the topic on ROS 1 or ROS 2. Publishers and subscribers of one topic that are both YARP ports are connected
directly.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import weakref
from typing import Any, Self

from yarp_compat.naming import connections
from yarp_compat.naming.errors import NamingError
from yarp_compat.os import bridge
from yarp_compat.os.buffered_port import BufferedPort
from yarp_compat.os.contactable import Contactable
from yarp_compat.os.nested import CLIENT, LATCHED, PUBLISHER, SERVER, SUBSCRIBER, NestedName
from yarp_compat.os.port import Port
from yarp_compat.os.runtime import RUNTIME
from yarp_compat.ports.events import ConnectionEvent
from yarp_compat.rosmsg import get as message_class
from yarp_compat.wire.errors import WireError

log = logging.getLogger("yarp.os.Node")

_OPPOSITE = {PUBLISHER: SUBSCRIBER, SUBSCRIBER: PUBLISHER, CLIENT: SERVER, SERVER: CLIENT}

_nodes: list[weakref.ref[Node]] = []
_lock = threading.Lock()


class Node:
    """A ROS node: topics opened while it is the newest one are its own. Its end closes them."""

    def __init__(self, name: str = "") -> None:
        self._port = Port()
        self._ports: weakref.WeakSet[Contactable] = weakref.WeakSet()
        self._name = ""
        if name:
            self.prepare(name)

    def prepare(self, name: str) -> None:
        """Open the node's own port and make this the newest node."""
        if self._name:
            return
        self._name = name
        self._port.setReadOnly()
        self._port.open(name)
        self._port.acquireProperties()["node_like"] = 1
        with _lock:
            _nodes.append(weakref.ref(self, _nodes.remove))

    def getName(self) -> str:
        """The node's name."""
        return self._name

    def add(self, port: Contactable) -> None:
        """Count a port as this node's."""
        self._ports.add(port)

    def interrupt(self) -> None:
        """Let whoever waits for one of the node's ports go."""
        for port in (self._port, *self._ports):
            port.interrupt()

    def close(self) -> None:
        """Close the node's ports, and the node."""
        with _lock:
            _nodes[:] = [node for node in _nodes if node() is not self]
        for port in list(self._ports):
            port.close()
        self._port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()


def active_node() -> str:
    """The newest node's name; empty when there is none."""
    with _lock:
        node = _nodes[-1]() if _nodes else None
    return node.getName() if node is not None else ""


class Publisher(BufferedPort):
    """Publishes messages of one type on a ROS topic.

    Args:
        content: the message class, ``yarp.rosmsg.std_msgs.String``, or its type's name.
        topic: opened at once when given.
        latched: whoever comes later gets the last message.

    Example::

        node = yarp.Node("/talker")
        publisher = yarp.Publisher("std_msgs/String", "/chatter")
        publisher.write(yarp.rosmsg.std_msgs.String(data="hello"))
    """

    def __init__(self, content: type[Any] | str, topic: str = "", *, latched: bool = False) -> None:
        super().__init__(message_class(content) if isinstance(content, str) else content)
        self.setWriteOnly()
        self._wait = True
        self._latched = latched
        self._kept: bytes | None = None
        if topic:
            self.topic(topic)

    def topic(self, name: str) -> bool:
        """Publish on this topic, as the newest node (or the one behind ``@`` in the name)."""
        self.includeNodeInName(True)
        return self.open(name)

    def enableBackgroundWrite(self, backgroundFlag: bool) -> None:
        """Whether writing a message returns before the peers took it; a slow peer then gets the newest only."""
        self._wait = not backgroundFlag

    def write(self, forceStrict: Any = False) -> Any:
        """Send a message and return whether all took it; or send the prepared one, as `BufferedPort.write`."""
        if isinstance(forceStrict, bool):
            self._keep(self._prepared)
            super().write(forceStrict)
            return None
        self._keep(forceStrict)
        core = self._core
        if core is None or self._interrupted:
            return False
        try:
            count = len(core.outputs())
            reached = core.write(forceStrict.to_wire, self._envelope, strict=self._wait, wait=self._wait)
        except (WireError, OSError) as err:
            log.error("port %s cannot write: %s", core.name, err)
            return False
        return reached >= count or not self._wait

    @property
    def is_latched(self) -> bool:
        """Whether whoever comes later gets the last message."""
        return self._latched

    def _keep(self, message: Any) -> None:
        """Remember what was written last, for who comes later."""
        if self._latched and message is not None:
            with contextlib.suppress(WireError):  # writing it will say so
                self._kept = b"".join(message.to_wire(RUNTIME.profile))

    def _began(self) -> None:
        super()._began()
        if self._latched and self._core is not None:  # known before it listens, at the name server only later
            self._core.properties[LATCHED] = 1

    def _tell(self, event: ConnectionEvent) -> None:
        super()._tell(event)
        core, kept = self._core, self._kept
        if kept is not None and core is not None and event.up and not event.incoming:
            core.write(kept, strict=True, chosen=lambda output: output.route.target == event.route.target)


class Subscriber(BufferedPort):
    """Reads messages of one type from a ROS topic; arguments as of `Publisher`."""

    def __init__(self, content: type[Any] | str, topic: str = "") -> None:
        super().__init__(message_class(content) if isinstance(content, str) else content)
        self.setReadOnly()
        if topic:
            self.topic(topic)

    def topic(self, name: str) -> bool:
        """Subscribe to this topic, as the newest node (or the one behind ``@`` in the name)."""
        self.includeNodeInName(True)
        return self.open(name)

    def read(self, shouldWait: Any = True) -> Any:
        """The next message or None, as `BufferedPort.read`; given a message, wait, fill it, return whether it was."""
        if isinstance(shouldWait, bool):
            return super().read(shouldWait)
        found = super().read(True)
        if found is None:
            return False
        shouldWait.from_wire(b"".join(found.to_wire()))
        return True


def joined(port: Contactable, name: NestedName, type_name: str) -> None:
    """A port of a topic or service is open: tell its type, count it to its node, connect it to YARP's other ends."""
    for node in (ref() for ref in list(_nodes)):
        if node is not None and node.getName() == name.node:
            node.add(port)
    try:
        if type_name:
            RUNTIME.naming.set_property(name.port, "type", type_name)
        if isinstance(port, Publisher) and port.is_latched:
            RUNTIME.naming.set_property(name.port, LATCHED, True)
        for contact in RUNTIME.listed():
            other = NestedName.parse(contact.name)
            if other.topic == name.topic and other.role == _OPPOSITE[name.role]:
                _connect(name, other)
        if RUNTIME.client is not None and bridge.find() is None:
            log.warning(
                "no Midspan daemon is on this YARP network: %s reaches YARP ports only, and ROS as soon as one starts",
                name.topic,
            )
    except NamingError as err:
        log.warning("%s: %s", name.port, err)


def _connect(one: NestedName, other: NestedName) -> None:
    source, target = (one, other) if one.role in (PUBLISHER, CLIENT) else (other, one)
    try:
        connections.connect(RUNTIME.naming, source.port, target.port)
    except NamingError as err:
        log.info("%s: %s", one.port, err)  # left behind by a program that died, as a rule
