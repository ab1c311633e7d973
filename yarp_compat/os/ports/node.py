"""ROS topics from YARP code: `Node`, `Publisher`, `Subscriber`, on ordinary ports named ``/topic+@/node``.

No ROS library is needed: a Midspan daemon on the same YARP network finds such a port at the name server and bridges it
to the topic on ROS 1 or ROS 2. YARP publishers and subscribers of the same topic are connected directly.
"""

from __future__ import annotations

import contextlib
import logging
import weakref
from typing import Any, Self

from yarp_compat.os.ports.buffered_port import BufferedPort
from yarp_compat.os.ports.contactable import NODES, Contactable
from yarp_compat.os.ports.nested import LATCHED
from yarp_compat.os.ports.port import Port
from yarp_compat.os.runtime import RUNTIME
from yarp_compat.overriding import override
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.rosmsg import get as message_class
from yarp_compat.wire.accessors import getter
from yarp_compat.wire.errors import WireError

log = logging.getLogger("yarp.os.Node")


class Node:
    """A ROS node: topics opened while it is the newest node belong to it, and are closed with it."""

    def __init__(self, name: str = "") -> None:
        self._port = Port()
        self._ports: weakref.WeakSet[Contactable] = weakref.WeakSet()
        self._name = ""
        if name:
            self.prepare(name)

    def prepare(self, name: str) -> None:
        """Open the node's port and make this the newest node."""
        if self._name:
            return
        self._name = name
        self._port.setReadOnly()
        self._port.open(name)
        self._port.acquireProperties()["node_like"] = 1
        NODES.add(self)

    getName = getter("_name", str, "The node's name.")

    def add(self, port: Contactable) -> None:
        """Add a port to this node."""
        self._ports.add(port)

    def interrupt(self) -> None:
        """Release the threads that wait for the node's ports."""
        for port in (self._port, *self._ports):
            port.interrupt()

    def close(self) -> None:
        """Close the node and its ports."""
        NODES.discard(self)
        for port in list(self._ports):
            port.close()
        self._port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()


class _TopicPort(BufferedPort):
    """A port for messages of one type, given by its class or name, on a ROS topic."""

    def __init__(self, content: type[Any] | str) -> None:
        super().__init__(message_class(content) if isinstance(content, str) else content)

    def topic(self, name: str) -> bool:
        """Publish on or subscribe to a topic, as the newest node (or the one after ``@`` in the name)."""
        self.includeNodeInName(True)
        return self.open(name)


class Publisher(_TopicPort):
    """A publisher of messages of one type on a ROS topic.

    Args:
        content: the message class, ``yarp.rosmsg.std_msgs.String``, or the name of its type.
        topic: the topic to open at once, if any.
        latched: whether late joiners receive the last message.

    Example::

        node = yarp.Node("/talker")
        publisher = yarp.Publisher("std_msgs/String", "/chatter")
        publisher.write(yarp.rosmsg.std_msgs.String(data="hello"))
    """

    def __init__(self, content: type[Any] | str, topic: str = "", *, latched: bool = False) -> None:
        super().__init__(content)
        self.setWriteOnly()
        self._wait = True
        self._latched = latched
        self._last_message: bytes | None = None
        if topic:
            self.topic(topic)

    def enableBackgroundWrite(self, backgroundFlag: bool) -> None:
        """Select whether `write` returns before the message is sent; a slow peer then gets only the newest."""
        self._wait = not backgroundFlag

    @override
    def write(self, forceStrict: Any = False) -> Any:
        """Send a message and return whether all peers received it; or send the prepared one like `BufferedPort`."""
        if isinstance(forceStrict, bool):
            self._store_last(self._prepared)
            super().write(forceStrict)
            return None
        self._store_last(forceStrict)
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

    def _store_last(self, message: Any) -> None:
        """Store the last message for late joiners."""
        if self._latched and message is not None:
            with contextlib.suppress(WireError):  # writing it reports the error
                self._last_message = b"".join(message.to_wire(RUNTIME.profile))

    @override
    def _on_open(self) -> None:
        super()._on_open()
        if self._latched and self._core is not None:  # set before the port listens; the name server gets it only later
            self._core.properties[LATCHED] = 1

    @override
    def _on_event(self, event: ConnectionEvent) -> None:
        super()._on_event(event)
        core = self._core
        if core is None or not event.up or event.incoming:
            return
        repeated: bytes | None = None
        while (last := self._last_message) is not None and last is not repeated:  # a newer one may have been sent first
            core.write(last, strict=True, chosen=lambda output: output.route.target == event.route.target)
            repeated = last


class Subscriber(_TopicPort):
    """A subscriber to messages of one type on a ROS topic; for the arguments, see `Publisher`."""

    def __init__(self, content: type[Any] | str, topic: str = "") -> None:
        super().__init__(content)
        self.setReadOnly()
        if topic:
            self.topic(topic)

    @override
    def read(self, shouldWait: Any = True) -> Any:
        """Return the next message like `BufferedPort.read`; or wait, fill a given message, return whether one came."""
        if isinstance(shouldWait, bool):
            return super().read(shouldWait)
        message = super().read(True)
        if message is None:
            return False
        shouldWait.from_wire(b"".join(message.to_wire()))
        return True
