"""The name server's logic, without sockets: commands and their replies.

The commands are those of yarpserver 3.12.3 and 4.0 (``NameServiceOnTriples.cpp``, ``Subscriber.cpp``, and captures). In
addition, names are validated, everything is bounded, and a port that repeats its registration unchanged keeps its state
(this package's ports repeat it after an outage of the name server).
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from yarp_compat.naming.allocation import Allocator
from yarp_compat.naming.subscriptions import Subscriptions, WantedConnection
from yarp_compat.wire.contact import MAX_NAME, PortContact, is_name
from yarp_compat.wire.text import from_text, plain_text, to_text
from yarp_compat.wire.values import Vocab


@dataclass(slots=True)
class Command:
    """A command, its reply and its effects."""

    words: Sequence[Any] = ()  # the command's values
    bot: bool = False  # the client requests a Bottle instead of lines
    remote: str = ""  # the sender's address
    # the reply as a Bottle's values; it is sent as lines if it begins with `OLD`
    values: list[Any] = field(default_factory=lambda: [OLD])
    # messages to the subscribers of the name server's port: ``[add] /p`` and ``[del] /p``
    events: list[list[Any]] = field(default_factory=list)
    connections: list[WantedConnection] = field(default_factory=list)  # connections to make
    changed: bool = False  # the state to save has changed

    def word(self, index: int) -> str:
        """Return a word as text; empty if the command has fewer words."""
        return plain_text(self.words[index]) if index < len(self.words) else ""

    def name(self, index: int) -> str:
        """Return a word if it is a string, else an empty string (a browser's request ends with lists)."""
        value = self.words[index] if index < len(self.words) else ""
        return str(value) if isinstance(value, str) else ""

    @property
    def head(self) -> list[Any]:
        """An empty reply in the requested form; lines begin with it."""
        return [] if self.bot else [OLD]


def plain_name(name: str) -> str:
    """Return a name without its carrier and without a requested network (``/net=eth0/p``)."""
    name = PortContact.parse(name).name if ":/" in name else name
    if name[:5].lower() == "/net=" and "/" in name[5:]:
        return name[name.index("/", 5) :]
    return name


def wants_json(words: Sequence[Any]) -> bool:
    """Whether a browser requests JSON, which needs values instead of lines."""
    return ["format", "json"] in words or ("format", "json") in itertools.pairwise(words)


OLD = "old"  # the first word of a reply that is sent as lines of text, the protocol of YARP's oldest programs

STYLE = (
    "body {\n  background: white;\n  color: black;\n  font-family: sans-serif;\n}\nh1 {\n  color: #336;\n}\n"
    "div {\n  padding-bottom: 10px;\n}\na {\n  color: #114499;\n  text-decoration: none;\n}\n"
)

HELP = (
    "+ help",
    "+ list [$prefix]",
    "+ register $portname",
    "+ register $portname $carrier $ipAddress $portNumber",
    "  (if you want a field set automatically, write '...')",
    "+ unregister $portname",
    "+ query $portname",
    "+ set $portname $property $value",
    "+ get $portname $property",
    "+ check $portname $property",
    "+ route $port1 $port2",
    "+ runners",
    "  (to get a list of the yarprun ports)",
)


def lines(values: Sequence[Any]) -> list[str]:
    """Return the lines of a reply that begins with `OLD`, including the end mark, without line breaks."""
    shown = [to_text(v).replace('"', "") if isinstance(v, list | tuple) else plain_text(v) for v in values[1:]]
    return [*filter(None, shown), "*** end of message"]


def as_words(c: PortContact) -> list[Any]:
    """Return the description of a port for a reply in lines."""
    return ["registration", "name", c.name, "ip", c.host, "port", c.port, "type", c.carrier]


def as_bottle(c: PortContact) -> list[Any]:
    """Return the description of a port as a Bottle."""
    return ["port", ["name", c.name], ["ip", c.host], ["port_number", c.port], ["carrier", c.carrier]]


def as_value(text: str) -> Any:
    """Return the value that a property's text represents; the text itself unless it is exactly one value."""
    try:
        values = from_text(text)
    except ValueError:
        return text
    return values[0] if len(values) == 1 else text


def code(done: bool) -> list[Any]:
    """Return ``[ok]`` or ``[fail]``."""
    return [Vocab("ok" if done else "fail")]


MAX_PORTS = 10_000
MAX_PROPERTY_CHARACTERS = 8 * 1024  # characters of all properties of one port

MAX_OWNED_DEPTH = 16  # levels of entries that are removed with the port that owns them


@dataclass(slots=True)
class PortEntry:
    """A registered port, with the time of its registration (``since``, on the registry's clock).

    ``announced`` is whether the port has announced that it listens; `PortRegistry.add` assumes so.
    """

    contact: PortContact
    since: float
    properties: dict[str, list[str]] = field(default_factory=dict)
    announced: bool = False


class PortRegistry:
    """The state of a name server, whose own port is registered from the start; ``clock`` is monotonic."""

    def __init__(self, server: PortContact, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.server = server
        self._clock = clock
        self._ports: dict[str, PortEntry] = {}
        self._allocator = Allocator(server.port)
        self._subscriptions = Subscriptions(self._is_port)
        self._types: dict[tuple[str, str], str] = {}
        self.add(server)
        self._ports[server.name].properties["nameserver"] = ["true"]

    def add(self, contact: PortContact) -> None:
        """Register a port with a complete contact, such as the name server's own."""
        self._ports[contact.name] = PortEntry(contact, self._clock(), announced=True)
        self._subscriptions.on_announced(contact.name)

    def apply(self, request: Sequence[Any], remote: str = "") -> Command:
        """Execute a command from the address ``remote``, and return it with its reply and its effects.

        ``NAME_SERVER`` and ``bot`` may precede the command's words.
        """
        request = list(request)
        bot = wants_json(request)
        if request and request[0] == "NAME_SERVER":
            request = request[1:]
        if request and request[0] == "bot":
            bot, request = True, request[1:]
        command = Command(request, bot, remote)
        perform = getattr(self, f"_do_{command.word(0)}", None)
        if perform:
            command.values = perform(command)
        return command

    def remove(self, names: Iterable[str]) -> Command:
        """Remove dead ports; return the effects."""
        command = Command()
        for name in names:
            if name != self.server.name:
                self._remove(command, name)
        return command

    def entries(self) -> list[PortEntry]:
        """Return all registered ports, sorted by name."""
        return [self._ports[name] for name in sorted(self._ports, key=_in_bytes)]

    def find(self, name: str) -> PortContact | None:
        """Return the address of a port; None if it is unknown."""
        entry = self._ports.get(name)
        return entry.contact if entry else None

    def wanted(self) -> list[WantedConnection]:
        """Return the persistent connections to make now."""
        return self._subscriptions.wanted()

    def age(self, entry: PortEntry) -> float:
        """Return the seconds since a port was registered."""
        return self._clock() - entry.since

    def state(self) -> dict[str, Any]:
        """Return the state, in types that JSON supports."""
        return {
            "own": self._ports[self.server.name].properties,
            "ports": [
                [e.contact.name, e.contact.carrier, e.contact.host, e.contact.port, e.properties]
                for e in self._ports.values()
                if e.contact.name != self.server.name
            ],
            "types": [[family, name, value] for (family, name), value in self._types.items()],
            "allocation": self._allocator.state(),
            "subscriptions": self._subscriptions.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore what `state` returned; raises `KeyError`, `TypeError` or `ValueError` if it is invalid."""
        self._ports[self.server.name].properties.update(_properties(state.get("own", {})))
        for name, carrier, host, port, properties in state["ports"]:
            sane = is_name(name) and is_name(carrier) and is_name(host) and 0 <= int(port) <= 0xFFFF
            if sane and name != self.server.name and len(self._ports) < MAX_PORTS:
                self.add(PortContact(name, host, int(port), carrier))
                self._ports[name].properties.update(_properties(properties))
        self._types = {(str(family), str(name)): str(value) for family, name, value in state["types"]}
        self._allocator.restore(state["allocation"])
        self._subscriptions.restore(state["subscriptions"])

    # -- registering ---------------------------------------------------------------------------------------------

    def _do_register(self, command: Command) -> list[Any]:
        requested = self._parse_contact(command)
        if requested is None:
            return [OLD]
        known = self._ports.get(requested.name)
        if known and known.contact == requested:
            # repeated after a restart of the name server, or by the next program of a killed one with the same number
            known.since, known.announced = self._clock(), False
            return self._described(command, requested.name)
        if known:
            self._remove(command, requested.name)
        contact = self._completed(requested)
        if contact is None or len(self._ports) >= MAX_PORTS:
            return [OLD]
        self._ports[contact.name] = PortEntry(contact, self._clock())
        type_name = command.name(5)
        if type_name and type_name != "*":
            self._ports[contact.name].properties["type"] = [type_name]
        command.changed = True
        if contact.carrier != "mcast":
            command.events.append([Vocab("add"), contact.name])
        return self._described(command, contact.name)

    def _parse_contact(self, command: Command) -> PortContact | None:
        """Return the requested contact, possibly incomplete; None if it cannot be registered."""
        name, carrier, host = (command.name(i) for i in (1, 2, 3))
        number = command.word(4)
        carrier = "tcp" if carrier in ("", "...") else carrier
        if host in ("", "..."):
            host = "..." if carrier == "mcast" else command.remote or "localhost"
        port = int(number) if number.isdecimal() and len(number) < 6 else 0
        if carrier == "topic":
            host, port = self.server.host, self.server.port
        if name == self.server.name or port > 0xFFFF:
            return None
        if not (is_name(name) and is_name(carrier) and is_name(host)):
            return None
        return PortContact(name, host, port, carrier)

    def _completed(self, requested: PortContact) -> PortContact | None:
        """Allocate the name, multicast group and port number that a request leaves open; None if that is impossible."""
        name: str | None = requested.name
        if requested.name == "..." or requested.name.startswith("="):
            allocated = self._allocator.name()
            while allocated in self._ports:
                allocated = self._allocator.name()
            name = allocated if requested.name == "..." or allocated is None else allocated + requested.name
        if name is None or not is_name(name):
            return None
        host: str | None = requested.host
        if requested.carrier == "mcast" and host == "...":
            host = self._allocator.group()
        number: int | None = requested.port
        if not number:
            number = self._allocator.number(name, {e.contact.port for e in self._ports.values()})
        if host is None or number is None:
            return None
        return PortContact(name, host, number, requested.carrier)

    def _do_unregister(self, command: Command) -> list[Any]:
        name = command.name(1)
        if name != self.server.name:
            self._remove(command, name)
        return self._described(command, name)

    def _remove(self, command: Command, name: str, depth: int = 0) -> None:
        """Remove a port and the entries that it owns (a port that writes over mcast owns its group's entry)."""
        self._subscriptions.on_removed(name)
        entry = self._ports.pop(name, None)
        if entry is None:
            return
        contact = entry.contact
        self._allocator.free(contact.name, contact.host, contact.port)
        command.changed = True
        if contact.carrier != "mcast":
            command.events.append([Vocab("del"), name])
        for owned in entry.properties.get("owns", ()):
            if depth < MAX_OWNED_DEPTH and owned != self.server.name:
                self._remove(command, owned, depth + 1)

    # -- queries -------------------------------------------------------------------------------------------------

    def _do_query(self, command: Command) -> list[Any]:
        return self._described(command, plain_name(command.name(1)))

    def _described(self, command: Command, name: str) -> list[Any]:
        entry = self._ports.get(name)
        if command.bot:
            line = as_bottle(entry.contact) if entry else ["port", ["error", -2, "port not known"]]
            # like yarpserver, reply to a registration in lines even if the client requests a Bottle
            return [OLD, *line] if command.word(0) in ("register", "unregister") else line
        return [OLD, as_words(entry.contact)] if entry else [OLD]

    def _do_list(self, command: Command) -> list[Any]:
        prefix = command.name(1)
        inside = prefix if prefix.endswith("/") else prefix + "/"
        return self._shown(command, lambda name, _: not prefix or name == prefix or name.startswith(inside))

    def _do_runners(self, command: Command) -> list[Any]:
        return self._shown(command, lambda _, entry: "true" in entry.properties.get("yarprun", ()))

    def _shown(self, command: Command, chosen: Callable[[str, PortEntry], bool]) -> list[Any]:
        entries = [e for e in self.entries() if chosen(e.contact.name, e)]
        if command.bot:
            return ["ports", *(as_bottle(e.contact) for e in entries)]
        return [OLD, *(as_words(e.contact) for e in entries)]

    def _do_route(self, command: Command) -> list[Any]:
        source, target = command.name(1), command.name(2)
        return [OLD, ["port", source, "route", target, "=", f"tcp:/{target}"]]

    def _do_gc(self, _command: Command) -> list[Any]:
        return [OLD, ["garbage collection done."]]

    def _do_web(self, _command: Command) -> list[Any]:
        return ["web", STYLE, "mime", "text/css"]

    def _do_help(self, command: Command) -> list[Any]:
        head = [] if command.bot else [OLD, "Here are some ways to use the name server:"]
        return [*head, *HELP]

    # -- properties ----------------------------------------------------------------------------------------------

    def _do_set(self, command: Command) -> list[Any]:
        entry, key = self._ports.get(command.name(1)), command.word(2)
        if entry is None:
            return command.head
        values = [plain_text(v) for v in command.words[3:]]
        properties = entry.properties
        others = sum(len(k) + sum(map(len, v)) for k, v in properties.items() if k != key)
        if others + len(key) + sum(map(len, values)) <= MAX_PROPERTY_CHARACTERS:
            command.changed = properties.get(key) != values
            properties[key] = values
        return self._do_get(command)

    def _do_get(self, command: Command) -> list[Any]:
        name, key = command.name(1), command.word(2)
        entry = self._ports.get(name)
        if entry is None:
            return command.head
        values = sorted(entry.properties.get(key, ()), key=_in_bytes)
        if command.bot:
            return [as_value(v) for v in values]
        return [OLD, ["port", name, "property", key, "=", *values]]

    def _do_check(self, command: Command) -> list[Any]:
        name, key, value = command.name(1), command.word(2), command.word(3)
        entry = self._ports.get(name)
        if entry is None:
            return [OLD]
        present = "true" if value in entry.properties.get(key, ()) else "false"
        return [OLD, ["port", name, "property", key, "value", value, "present", present]]

    # -- persistent connections and topics -------------------------------------------------------------------------

    def _do_subscribe(self, command: Command) -> list[Any]:
        source, target, mode = (command.name(i) for i in (1, 2, 3))
        if not target:
            return self._subscriptions.listing(PortContact.parse(source).name)
        connections = self._subscriptions.add(source, target, mode)
        command.changed = connections is not None
        command.connections += connections or ()
        return code(connections is not None)

    def _do_unsubscribe(self, command: Command) -> list[Any]:
        self._subscriptions.remove(command.name(1), command.name(2))
        command.changed = True
        return code(True)

    def _do_announce(self, command: Command) -> list[Any]:
        name = command.name(1)
        alive = len(command.words) < 3 or command.words[2] != 0
        # a port that a client cannot reach is not removed, because the fault may be on the client's side
        if alive and self._is_port(name):
            entry = self._ports[name]
            command.connections += self._subscriptions.on_announced(name, force=not entry.announced)
            command.changed = entry.announced = True
        return code(True)

    def _do_topic(self, command: Command) -> list[Any]:
        if len(command.words) < 2:
            return list(self._subscriptions.topics())
        connections = self._subscriptions.set_topic(command.name(1), command.name(2))
        command.changed = connections is not None
        command.connections += connections or ()
        return code(connections is not None)

    def _do_untopic(self, command: Command) -> list[Any]:
        self._subscriptions.remove_topic(command.name(1))
        command.changed = True
        return code(True)

    def _do_type(self, command: Command) -> list[Any]:
        key = command.word(1), command.word(2)
        sane = all(len(command.word(i)) <= MAX_NAME for i in (1, 2, 3))
        if len(command.words) == 4 and sane and (key in self._types or len(self._types) < MAX_PORTS):
            self._types[key] = command.word(3)
            command.changed = True
            return code(True)
        if len(command.words) == 3 and key in self._types:
            return ["type", *key, self._types[key]]
        return code(False)

    def _is_port(self, name: str) -> bool:
        entry = self._ports.get(name)
        return entry is not None and entry.contact.carrier != "topic"


def _properties(state: Mapping[str, Any]) -> dict[str, list[str]]:
    return {str(key): [str(value) for value in values] for key, values in state.items()}


def _in_bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")
