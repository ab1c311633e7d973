"""``Network``: the name server, and connections between any ports of the network."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any, Self

from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address, file, folder, namespace
from yarp_compat.os.clock import use_environment_clock
from yarp_compat.os.data.bottle import Bottle, Value
from yarp_compat.os.ports.contact import Contact, ContactStyle
from yarp_compat.os.qos import QosStyle
from yarp_compat.os.runtime import RUNTIME, definition_from_daemon
from yarp_compat.ports import text_client
from yarp_compat.ports.naming import NamingError
from yarp_compat.rosmsg.library import LIBRARY
from yarp_compat.wire.contact import PortContact as WireContact
from yarp_compat.wire.contact import is_port_name
from yarp_compat.wire.values import Vocab

log = logging.getLogger("yarp.os.Network")

_POLL = 0.1  # seconds between checks for a port or a connection


class Network:
    """The network's functions that do not belong to a port. Call ``Network.init()`` first, ``Network.fini()`` last.

    An object does both: ``network = yarp.Network()`` calls ``init``, and its deletion or the end of ``with`` calls
    ``fini``. All methods are static. On failure, they log the reason, and return False or an invalid or missing object.
    """

    def __init__(self, clockType: int = 0) -> None:
        self.init(clockType)
        self._used = True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._finish()

    def __del__(self) -> None:
        self._finish()

    def _finish(self) -> None:
        if self._used:
            self._used = False
            RUNTIME.fini()

    @staticmethod
    def init(clockType: int = 0) -> None:  # noqa: ARG004
        """Start using the network, and the clock that ``YARP_CLOCK`` names; ``clockType`` has no effect."""
        LIBRARY.ask = definition_from_daemon
        RUNTIME.init(use_environment_clock)

    initMinimum = autoInitMinimum = init

    @staticmethod
    def fini() -> None:
        """Stop using the network; the call that matches the first `init` closes all open ports."""
        RUNTIME.fini()

    finiMinimum = fini

    @staticmethod
    def initialized() -> bool:
        """Return whether the network is in use."""
        return RUNTIME.is_up

    isNetworkInitialized = initialized

    @staticmethod
    def checkNetwork(timeout: float = -1) -> bool:
        """Return whether the name server answers, within ``timeout`` seconds if positive."""
        if RUNTIME.is_local:
            return True
        known = RUNTIME.client

        def check() -> bool:
            client = NameClient(known.address, timeout=timeout) if known and timeout > 0 else known
            return client is not None and client.lines(["list", namespace()]) is not None

        return _done(check, "the name server is unavailable")

    @staticmethod
    def connect(src: str, dest: str, carrier: str | ContactStyle | None = "", quiet: bool = True) -> bool:
        """Connect an output port to an input port; ``udp://r`` also selects the carrier.

        The default ``carrier`` is the one that the input port was registered with; ``quiet``: do not log the success.
        """
        style = _style(carrier, quiet)
        if style.persistent:
            return _persistent("subscribe", src, dest, style)
        return _logged(
            lambda: connections.connect(RUNTIME.naming, src, dest, style.carrier, **_timeout(style)),
            f"cannot connect {src} to {dest}",
            quiet=style.quiet,
        )

    @staticmethod
    def disconnect(src: str, dest: str, carrier: str | ContactStyle | bool | None = "", quiet: bool = True) -> bool:
        """Close the connection between two ports."""
        style = _style(carrier, quiet)
        if style.persistent:
            return _persistent("unsubscribe", src, dest, style)

        return _logged(
            lambda: connections.disconnect(RUNTIME.naming, src, dest, **_timeout(style)),
            f"cannot disconnect {src} from {dest}",
            quiet=style.quiet,
        )

    @staticmethod
    def isConnected(src: str, dest: str, carrier: str | ContactStyle | bool | None = "", quiet: bool = True) -> bool:
        """Return whether two ports are connected, over the given carrier if there is one."""
        style = _style(carrier, quiet)

        def is_connected() -> bool:
            carrier = connections.carrier_between(RUNTIME.naming, src, dest, **_timeout(style))
            return bool(carrier) and style.carrier in ("", carrier)

        return _done(is_connected, f"cannot check whether {src} and {dest} are connected", quiet=style.quiet)

    @staticmethod
    def exists(port: str, style: ContactStyle | bool = True, checkVer: bool = True) -> bool:  # noqa: ARG004
        """Return whether a port is registered and answers."""
        quiet = style.quiet if isinstance(style, ContactStyle) else style
        timeout = _timeout(style) if isinstance(style, ContactStyle) else {}
        problem = f"cannot check whether {port} exists"
        return _done(lambda: connections.exists(RUNTIME.naming, port, **timeout), problem, quiet=quiet)

    @staticmethod
    def sync(port: str, quiet: bool = True) -> bool:
        """Wait until a port answers, at most about 25 s."""
        return _wait(lambda: Network.exists(port, quiet), 25.0, f"{port} does not answer", quiet=quiet)

    @staticmethod
    def waitPort(target: str, quiet: bool = False) -> bool:
        """Wait without a limit until a port exists."""
        return _wait(lambda: Network.exists(target, True), None, f"waiting for port {target}", quiet=quiet)

    @staticmethod
    def waitConnection(source: str, destination: str, quiet: bool = False) -> bool:
        """Wait without a limit until two ports are connected."""
        message = f"waiting for the connection {source} -> {destination}"
        return _wait(lambda: Network.isConnected(source, destination, True), None, message, quiet=quiet)

    @staticmethod
    def queryName(name: str) -> Contact:
        """Return the contact of a port; invalid if it is not registered."""
        return Contact.of(_value(lambda: RUNTIME.naming.query(name), f"cannot query {name}"))

    @staticmethod
    def registerName(name: str) -> Contact:
        """Register a name without opening a port; return its contact."""
        return Contact.of(_value(lambda: RUNTIME.naming.register(name), f"cannot register {name}"))

    @staticmethod
    def registerContact(contact: Contact) -> Contact:
        """Register a contact's name with its address."""
        a = contact.address
        register = RUNTIME.naming.register
        problem = f"cannot register {a.name}"
        return Contact.of(_value(lambda: register(a.name, a.host, max(a.port, 0), carrier=a.carrier or "tcp"), problem))

    @staticmethod
    def unregisterName(name: str) -> Contact:
        """Unregister a name."""
        _value(lambda: RUNTIME.naming.unregister(name), f"cannot unregister {name}")
        return Contact()

    @staticmethod
    def unregisterContact(contact: Contact) -> Contact:
        """Unregister a contact's name."""
        return Network.unregisterName(contact.getRegName())

    @staticmethod
    def setProperty(name: str, key: str, value: Any) -> bool:
        """Store a value under a key of a registered port."""
        plain = value.plain if isinstance(value, Value) else value
        values = plain if isinstance(plain, (list, tuple)) else [plain]

        def set_property() -> bool:
            RUNTIME.naming.set_property(name, key, *values)
            return True

        return _done(set_property, f"cannot set the property {key} of {name}")

    @staticmethod
    def getProperty(name: str, key: str) -> Value | None:
        """Return the value under a key of a registered port, or None."""
        values = _value(lambda: RUNTIME.naming.get_property(name, key), f"cannot get the property {key} of {name}")
        if not values:
            return None
        return Value.of(values[0] if len(values) == 1 else list(values))

    @staticmethod
    def getNameServerName() -> str:
        """Return the name server's port name, ``/root`` unless another namespace is configured."""
        return _value(namespace, "cannot read the namespace") or ""

    @staticmethod
    def getNameServerContact() -> Contact:
        """Return the configured address of the name server."""
        client = RUNTIME.client
        return Contact.of(_value(lambda: client.contact, "the name server's address is unknown") if client else None)

    @staticmethod
    def setNameServerContact(contact: Contact) -> bool:
        """Use the name server at this address in this program."""
        if not contact.isValid():
            log.error("a name server's contact needs an address and a port number, not %r", contact.toString())
            return False
        RUNTIME.use(NameClient(Address(contact.getHost(), contact.getPort())))
        return True

    @staticmethod
    def setLocalMode(flag: bool) -> bool:
        """Register names only in this process, for programs whose ports connect only to each other."""
        RUNTIME.set_local(local=flag)
        return True

    @staticmethod
    def getLocalMode() -> bool:
        """Return whether names are registered only in this process."""
        return RUNTIME.is_local

    @staticmethod
    def setConnectionQos(src: str, dest: str, style: QosStyle, *rest: Any) -> bool:
        """Set the type of service of a connection's packets at both ends; a second style is for the end at ``dest``."""
        ends = [style, *(option for option in rest if isinstance(option, QosStyle))]
        quiet = next((option for option in rest if isinstance(option, bool)), True)

        def set_end(port: str, other: str, style: QosStyle) -> bool:
            if style.getPacketPriorityAsTOS() == -1 and style.getThreadPolicy() == -1:
                return True
            sched = {"priority": style.getThreadPriority(), "policy": style.getThreadPolicy()}
            qos = {"tos": style.getPacketPriorityAsTOS()}
            command, reply = Bottle(["prop", "set", other, ["sched", sched], ["qos", qos]]), Bottle()
            return Network.write(port, command, reply, True, quiet, 2.0) and reply.get(0).asString() == "ok"

        return set_end(src, dest, ends[0]) and set_end(dest, src, ends[-1])

    @staticmethod
    def getConnectionQos(src: str, dest: str, srcStyle: QosStyle, destStyle: QosStyle, quiet: bool = True) -> bool:
        """Store in the two styles the types of service that the source and the destination of a connection report."""

        def read_end(port: str, other: str, style: QosStyle) -> bool:
            reply = Bottle()
            if not Network.write(port, Bottle(["prop", "get", other]), reply, True, quiet, 2.0):
                return False
            qos = reply.findGroup("qos").get(1)
            if qos.asSearchable() is None:
                return False
            style.setPacketPrioritybyTOS(qos.find("tos").asInt32())
            return True

        return read_end(src, dest, srcStyle) and read_end(dest, src, destStyle)

    @staticmethod
    def disconnectInput(src: str, dest: str, silent: bool = False) -> bool:
        """Close a connection at its reading port."""
        reply = Bottle()
        command = Bottle([Vocab("del"), src])
        return Network.write(dest, command, reply, True, silent) and reply.get(0).asInt32() == 0

    @staticmethod
    def setVerbosity(verbosity: int) -> None:
        """Set the log level: info (0, the default), debug (above 0) or warnings (below 0)."""
        level = logging.WARNING if verbosity < 0 else logging.DEBUG if verbosity else logging.INFO
        logging.getLogger("yarp").setLevel(level)

    @staticmethod
    def isValidPortName(name: str) -> bool:
        """Return whether this is a valid port name."""
        return is_port_name(name)

    @staticmethod
    def getConfigFile(name: str) -> str:
        """Return the path of one of YARP's configuration files; for ``yarp.conf`` that of the namespace."""
        return str(file()) if name == "yarp.conf" else f"{folder()}/{name}"

    @staticmethod
    def write(contact: Contact | str, command: Any, reply: Any, *options: Any) -> bool:
        """Send a message, usually a Bottle, and read the reply; options: a `ContactStyle`, or admin, quiet, timeout."""
        style = _write_style(options)

        def write() -> bool:
            address = _address_of(contact)
            timeout = style.timeout if style.timeout > 0 else text_client.TIMEOUT
            lines = text_client.ask(address, command.to_values(), admin=style.admin, timeout=timeout)
            reply.from_text(lines[0] if lines else "")
            return True

        return _done(write, f"cannot write to {contact}", quiet=style.quiet)

    @staticmethod
    def writeToNameServer(command: Any, reply: Any, style: ContactStyle | None = None) -> bool:
        """Send a command to the name server and read the reply."""
        return Network.write(Network.getNameServerContact(), command, reply, style or ContactStyle())

    @staticmethod
    def assertion(shouldBeTrue: bool) -> None:
        """Raise `AssertionError` unless the argument is true."""
        if not shouldBeTrue:
            raise AssertionError("assertion failed")


NetworkBase = Network


def _address_of(contact: Contact | str) -> WireContact:
    name = contact if isinstance(contact, str) else contact.getRegName()
    known = WireContact.parse(contact) if isinstance(contact, str) else contact.address
    address = known if known.is_valid else RUNTIME.naming.query(name)
    if address is None:
        raise NamingError(f"port {name} is not registered")
    return address


def _write_style(options: tuple[Any, ...]) -> ContactStyle:
    if options and isinstance(options[0], ContactStyle):
        return options[0]
    names = ("admin", "quiet", "timeout")
    return ContactStyle(**dict(zip(names, options, strict=False)))


def _style(carrier: str | ContactStyle | bool | None, quiet: bool) -> ContactStyle:
    if isinstance(carrier, ContactStyle):
        return carrier
    if isinstance(carrier, bool):
        return ContactStyle(quiet=carrier)
    return ContactStyle(carrier=carrier or "", quiet=quiet)


def _timeout(style: ContactStyle) -> dict[str, float]:
    return {"timeout": style.timeout} if style.timeout > 0 else {}


def _persistent(verb: str, src: str, dest: str, style: ContactStyle) -> bool:
    """Ask the name server to maintain a connection, or to stop."""
    return _done(lambda: RUNTIME.persistent(verb, src, dest, style.carrier), f"cannot {verb} {src} to {dest}")


def _wait(ready: Callable[[], bool], limit: float | None, message: str, *, quiet: bool) -> bool:
    end = None if limit is None else time.monotonic() + limit
    logged = time.monotonic()
    while not ready():
        now = time.monotonic()
        if end is not None and now > end:
            return False
        if not quiet and now - logged > 1:
            log.info("%s", message)
            logged = now
        time.sleep(_POLL)
    return True


def _done(action: Callable[[], bool], problem: str, *, quiet: bool = False) -> bool:
    """Run an action and return whether it succeeded; log the reason if not."""
    return bool(_value(action, problem, quiet=quiet))


def _logged(action: Callable[[], str], problem: str, *, quiet: bool) -> bool:
    """Run an action and return whether it succeeded; log the port's answer unless ``quiet``."""
    text = _value(action, problem)
    if text is not None and not quiet:
        log.info("%s", text)
    return text is not None


def _value(action: Callable[[], Any], problem: str, *, quiet: bool = False) -> Any:
    try:
        return action()
    except (NamingError, OSError, ValueError) as err:
        log.log(logging.DEBUG if quiet else logging.ERROR, "%s: %s", problem, err)
        return None
