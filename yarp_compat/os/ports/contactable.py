"""The base class of YARP's ports: names, connections, modes. Each port wraps a `yarp_compat.ports.port.PortCore`."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import threading
import weakref
from collections.abc import Callable
from typing import Any, ClassVar, Protocol

from yarp_compat.naming import connections
from yarp_compat.os.ports.connection import PortReport, report
from yarp_compat.os.ports.contact import Contact
from yarp_compat.os.ports.inbox import Gate
from yarp_compat.os.ports.nested import CLIENT, LATCHED, PUBLISHER, SERVER, SUBSCRIBER, NestedName
from yarp_compat.os.runtime import RUNTIME, find_daemon
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NamingError
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.accessors import getter, setter
from yarp_compat.wire.contact import is_port_name, rooted
from yarp_compat.wire.errors import WireError

log = logging.getLogger("yarp.os.Port")
_node_log = logging.getLogger("yarp.os.Node")

_OPPOSITE = {PUBLISHER: SUBSCRIBER, SUBSCRIBER: PUBLISHER, CLIENT: SERVER, SERVER: CLIENT}

_EVENT_TEXTS = {
    (True, True): "Receiving input",
    (False, True): "Sending output",
    (True, False): "Removing input",
    (False, False): "Removing output",
}


class _Node(Protocol):
    def getName(self) -> str: ...
    def add(self, port: Contactable) -> None: ...


class Nodes:
    """Weak references to the program's ROS nodes."""

    def __init__(self) -> None:
        self._nodes: list[weakref.ref[_Node]] = []
        self._lock = threading.Lock()

    def add(self, node: _Node) -> None:
        """Add a node as the newest."""
        with self._lock:
            self._nodes.append(weakref.ref(node, self._nodes.remove))

    def discard(self, node: _Node) -> None:
        """Remove a closed node."""
        with self._lock:
            self._nodes[:] = [known for known in self._nodes if known() is not node]

    def active(self) -> str:
        """Return the newest node's name, or "" without a node."""
        with self._lock:
            node = self._nodes[-1]() if self._nodes else None
        return node.getName() if node is not None else ""

    def named(self, name: str) -> list[_Node]:
        """Return the nodes with this name."""
        nodes = [known() for known in list(self._nodes)]
        return [node for node in nodes if node is not None and node.getName() == name]


NODES = Nodes()


class Contactable:
    """The base class of ports. Methods return False when YARP's do, and log the reason."""

    _REPLIES: ClassVar[bool] = False  # whether writers may receive replies

    _latched = False  # whether late joiners receive the last message

    def __init__(self) -> None:
        self._verbosity = 1
        self._core: PortCore | None = None
        self._gate = Gate()  # replaced by the derived class; threads wait in it
        self._reporter: PortReport | None = None
        self._is_input: bool | None = None
        self._is_output: bool | None = None
        self._rpc = False
        self._in_node = False
        self._interrupted = False
        self._envelope = ""
        self._type = ""
        self._callback_lock: Any = contextlib.nullcontext()
        self._finalizer: weakref.finalize[..., Any] | None = None

    # -- opening and closing ------------------------------------------------------------------------------------------

    def open(self, name: str | Contact, registerName: bool = True) -> bool:
        """Register the port under a name and accept connections; on failure log the reason and return False.

        ``name``: ``/reader``; empty or ``...`` lets the name server choose; ``/topic@/node`` is an end of a ROS topic;
        a contact also gives the address to listen on. ``registerName``: register the port at the name server.
        """
        if not RUNTIME.is_up:
            log.error("YARP not initialized; call yarp.Network.init() before using ports")
            return False
        self.close()
        contact = name if isinstance(name, Contact) else Contact(name)
        requested = contact.getRegName()
        variable = _variable("YARP_RENAME", requested)
        renamed = os.environ.get(variable)
        full = self._full_name(renamed or requested)
        if full is None:
            if renamed:
                log.error("port %s is not opened: correct or unset %s, which renames it", requested, variable)
            return False
        return self._open(full, contact, _number(requested) or max(contact.getPort(), 0), register=registerName)

    def _full_name(self, name: str) -> str | None:
        """Return the full name to register; None, with the reason in the log, if it is invalid or incomplete."""
        if name in ("", "..."):
            return name
        name = os.environ.get("YARP_PORT_PREFIX", "") + name
        nested = NestedName.parse(name)
        if self._in_node or (nested.is_nested and not nested.node):
            node = NODES.active()
            if not nested.is_nested:
                nested = NestedName(f"/{nested.node.lstrip('/')}", node, type=nested.type)
            nested = nested.with_node(node)
        if not nested.is_nested:
            if is_port_name(name):
                return name
            log.error("%r is not a port name: YARP's names are like /robot/camera, without spaces or commas", name)
            return None
        self._type = self._type or nested.type
        nested = nested.with_role(self._role())
        if nested.role and nested.node:
            return nested.port
        plain = nested.port
        if not nested.node:
            log.error("%r names no node: make a yarp.Node first, or write %s/node", name, plain)
        else:
            log.error(
                "port %r is neither input nor output: call setWriteOnly() or setReadOnly(), or name it %s (publishes) "
                "or %s (subscribes)", name, nested.with_role(PUBLISHER).port, nested.with_role(SUBSCRIBER).port,
            )  # fmt: skip
        return None

    def _role(self) -> str:
        if self._is_input is False:
            return CLIENT if self._rpc else PUBLISHER
        if self._is_output is False:
            return SERVER if self._rpc else SUBSCRIBER
        return ""

    def _open(self, name: str, contact: Contact, number: int, *, register: bool) -> bool:
        naming = RUNTIME.naming if register else RUNTIME.unregistered
        core = PortCore(
            name, on_message=_weakly(self._on_message), naming=naming, rpc=self._rpc, type_name=self._type,
            host=contact.getHost() or None, number=number, profile=RUNTIME.profile,
            is_input=self._is_input is not False, is_output=self._is_output is not False, replies=self._REPLIES,
            on_event=_weakly(self._on_event),
        )  # fmt: skip
        self._interrupted = False
        self._core = core
        self._on_open()
        try:
            core.open()
        except (NamingError, OSError) as err:
            log.error("Port %s failed to activate (%s)", name or "without a name", err)
            self._core = None
            self._on_closing()
            return False
        # An unreferenced port is closed, as in C++.
        self._finalizer = weakref.finalize(self, core.close)
        self._finalizer.atexit = False
        RUNTIME.opened(self)
        log.info("Port %s active at %s", core.name, core.contact.uri)
        nested = NestedName.parse(core.name)
        if nested.is_nested:
            self._join_topic(nested)
        return True

    def _join_topic(self, name: NestedName) -> None:
        """Announce the type of a topic's or service's port, add it to its node, and connect it to its YARP peers."""
        for node in NODES.named(name.node):
            node.add(self)
        try:
            if self._type:
                RUNTIME.naming.set_property(name.port, "type", self._type)
            if self._latched:
                RUNTIME.naming.set_property(name.port, LATCHED, True)
            for contact in RUNTIME.listed():
                other = NestedName.parse(contact.name)
                if other.topic == name.topic and other.role == _OPPOSITE[name.role]:
                    _connect(name, other)
            if RUNTIME.client is not None and find_daemon() is None:
                _node_log.warning(
                    "no Midspan daemon on this YARP network: %s reaches only YARP ports, and ROS when a daemon starts",
                    name.topic,
                )
        except NamingError as err:
            _node_log.warning("%s: %s", name.port, err)

    def close(self) -> None:
        """Close all connections and unregister the name."""
        core, self._core = self._core, None
        if core is None:
            return
        RUNTIME.closed(self)
        self._on_closing()
        if self._finalizer is not None:
            self._finalizer.detach()
        core.close()
        self._on_closed(core)

    def interrupt(self) -> None:
        """Release waiting threads, and stop reading and writing until `resume`."""
        self._interrupted = True
        if self._core is not None:
            self._core.interrupt()
        self._gate.interrupt()

    def resume(self) -> None:
        """Continue after `interrupt`."""
        self._gate.resume()
        self._interrupted = False
        if self._core is not None:
            self._core.resume()

    def isOpen(self) -> bool:
        """Return whether the port is open."""
        return self._core is not None and self._core.is_open

    def getName(self) -> str:
        """Return the port's name; "" while it is closed."""
        return "" if self._core is None else self._core.name

    def where(self) -> Contact:
        """Return the port's name and address."""
        return Contact.of(None if self._core is None else self._core.contact)

    # -- the kind of port ---------------------------------------------------------------------------------------------

    def setReadOnly(self) -> None:
        """Make the port an input; call this before `open`."""
        self._is_input, self._is_output, self._rpc = True, False, False

    def setWriteOnly(self) -> None:
        """Make the port an output; call this before `open`."""
        self._is_input, self._is_output, self._rpc = False, True, False

    def setRpcServer(self) -> None:
        """Make the port a server, which receives requests and sends replies; call this before `open`."""
        self._is_input, self._is_output, self._rpc = True, False, True

    def setRpcClient(self) -> None:
        """Make the port a client, which sends requests and receives replies; call this before `open`."""
        self._is_input, self._is_output, self._rpc = False, True, True

    setInputMode = setter("_is_input", bool, "Whether the port reads.")
    setOutputMode = setter("_is_output", bool, "Whether the port writes.")
    setRpcMode = setter("_rpc", bool, "Whether messages have replies.")
    includeNodeInName = setter("_in_node", bool, "Whether the name is a topic of the active node.")
    promiseType = setter("_type", str, "Set the announced message type, such as ``std_msgs/String``, before `open`.")
    getType = getter("_type", str, "The announced type of the messages.")

    def acquireProperties(self, readOnly: bool = True) -> Any:  # noqa: ARG002
        """Return the port's properties, for ``[prop] [get]``, as a dict to change in place."""
        return {} if self._core is None else self._core.properties

    def releaseProperties(self, properties: Any) -> None:
        """Do nothing: the properties are changed in place."""

    # -- connections --------------------------------------------------------------------------------------------------

    def addOutput(self, name: str | Contact, carrier: str = "") -> bool:
        """Connect this port's output to another port."""
        core = self._core
        if core is None or self._interrupted or self._is_output is False:
            state = "closed" if core is None else "not an open output"
            log.error("%s cannot be connected: the port is %s", name, state)
            return False
        target = name.toString() if isinstance(name, Contact) else name
        if carrier:
            target = f"{carrier}:/{target}"
        done, message = core.add_output(target)
        log.log(logging.INFO if done else logging.ERROR, "%s", message)
        return done

    def getInputCount(self) -> int:
        """Return the number of input connections."""
        return 0 if self._core is None else len(self._core.inputs())

    def getOutputCount(self) -> int:
        """Return the number of output connections."""
        return 0 if self._core is None else len(self._core.outputs())

    def getReport(self, reporter: PortReport) -> None:
        """Report the port and its connections to ``reporter``."""
        if self._core is not None:
            report(self._core, reporter)

    def setReporter(self, reporter: PortReport) -> None:
        """Report connections that open and close to ``reporter``."""
        self._reporter = reporter

    def resetReporter(self) -> None:
        """Stop reporting connections."""
        self._reporter = None

    getVerbosity = getter("_verbosity", int, "Whether connection events are logged.")
    setVerbosity = setter("_verbosity", int, "Log connection events (1, the default), or not (0).")

    # -- messages -----------------------------------------------------------------------------------------------------

    def isWriting(self) -> bool:
        """Return whether a message is still being sent."""
        return self._core is not None and self._core.is_writing

    def setEnvelope(self, envelope: Any) -> bool:
        """Send this envelope (a Stamp, a Bottle) with every message from now on."""
        try:
            self._envelope = envelope.to_text()
        except WireError as err:
            log.error("port %s: %s", self.getName(), err)
            return False
        return True

    def setAdminReader(self, reader: Any) -> None:
        """Raise `NotImplementedError`: the port itself executes administrative commands."""
        raise NotImplementedError(
            "setAdminReader is not supported: ports of yarp_compat execute administrative commands themselves"
        )

    # -- a lock that callbacks hold -----------------------------------------------------------------------------------

    def setCallbackLock(self, mutex: Any = None) -> bool:
        """Hold a lock while readers and callbacks run: the given lock, or by default a new lock."""
        self._callback_lock = threading.RLock() if mutex is None else mutex
        return True

    def removeCallbackLock(self) -> bool:
        """Stop holding a lock while readers and callbacks run."""
        self._callback_lock = contextlib.nullcontext()
        return True

    def lockCallback(self) -> bool:
        """Wait for the running callback, and block others until `unlockCallback`; return False without a lock."""
        return self._has_lock and bool(self._callback_lock.acquire())

    def tryLockCallback(self) -> bool:
        """Block callbacks like `lockCallback`, without waiting; return False if one runs, or without a lock."""
        return self._has_lock and bool(self._callback_lock.acquire(blocking=False))

    def unlockCallback(self) -> None:
        """Let callbacks run again."""
        if self._has_lock:
            self._callback_lock.release()

    @property
    def _has_lock(self) -> bool:
        return hasattr(self._callback_lock, "acquire")

    # -- callbacks of the core ----------------------------------------------------------------------------------------

    def _on_message(self, message: PortMessage) -> None:
        """Handle a message, on its connection's thread."""
        raise NotImplementedError

    def _on_open(self) -> None:
        """Prepare for messages; called when the port opens."""

    def _on_closing(self) -> None:
        """Release waiting threads; called when the port closes."""

    def _on_closed(self, core: PortCore) -> None:
        """Clean up after the port has closed."""

    def _on_event(self, event: ConnectionEvent) -> None:
        route = event.route
        if rooted(route.source) and self._verbosity > 0:  # tools that send commands (``admin``) are not logged
            text = _EVENT_TEXTS[event.incoming, event.up]
            log.info("%s from %s to %s using %s", text, route.source, route.target, route.carrier)
        if self._reporter is not None and self._core is not None:
            report(self._core, self._reporter, event)


class UnbufferedContactable(Contactable):
    """The base class of ports without buffers: `Port`, `RpcServer`, `RpcClient`."""


def _variable(prefix: str, name: str) -> str:
    """Return a port's variable in the environment: ``YARP_RENAME_robot_camera`` (``NameConfig::getSafeString``)."""
    return prefix + re.sub(r"[^0-9A-Za-z]", "_", name)


def _number(name: str) -> int:
    """Return the TCP port number that the environment sets for a port; 0 if none."""
    variable = _variable("YARP_PORTNUMBER", name)
    text = os.environ.get(variable, "")
    if text.isascii() and text.isdecimal() and 0 < int(text) < 1 << 16:
        return int(text)
    if text:
        log.warning("ignored %s=%.40s: it must be a number from 1 to 65535", variable, text)
    return 0


def _connect(name: NestedName, other: NestedName) -> None:
    source, target = (name, other) if name.role in (PUBLISHER, CLIENT) else (other, name)
    try:
        connections.connect(RUNTIME.naming, source.port, target.port)
    except NamingError as err:
        _node_log.info("%s: %s", name.port, err)  # usually the port of a program that crashed


def _weakly(method: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a function that calls a method without keeping its object alive."""
    weak = weakref.WeakMethod(method)

    def call(argument: Any) -> None:
        bound = weak()
        if bound is not None:
            bound(argument)

    return call
