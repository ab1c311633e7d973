"""The addresses at which the programs of one configuration listen, and those that exclude each other."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

from bridge.config.document import Document, KeyPath, Problem, key_text
from bridge.config.model import Config
from bridge.config.sections.listen import ServerSection, split

_ANY_IPV4 = str(ipaddress.IPv4Address(0))
_TRANSPORTS = {"tcp": "tcp", "tls": "tcp", "ws": "tcp", "quic": "udp", "udp": "udp"}


@dataclass(frozen=True, slots=True)
class Listener:
    """An address, and the key that sets it; ``transport`` is ``tcp`` or ``udp``."""

    path: KeyPath
    text: str
    host: str
    port: int
    transport: str = "tcp"

    @property
    def key(self) -> str:
        """The key without the index of an item in a list."""
        return key_text(tuple(part for part in self.path if isinstance(part, str)))

    def excludes(self, other: Listener) -> bool:
        """Whether only one of two listeners can open its port on a machine; port 0 means any free port."""
        if (self.transport, self.port) != (other.transport, other.port) or self.port == 0:
            return False
        hosts = {self.host, other.host}
        if len(hosts) == 1 or "::" in hosts:  # :: also accepts IPv4
            return True
        return _ANY_IPV4 in hosts and not any(":" in host for host in hosts)


def listeners(config: Config) -> Iterator[Listener]:
    """Yield the addresses that the configuration opens."""
    yield from _zenoh(("hub", "listen"), config.hub.listen)
    for index, endpoint in enumerate(config.hub.open.listen):
        yield from _zenoh(("hub", "open", "listen", index), endpoint)
    for name, section in config:
        if isinstance(section, ServerSection) and section.enabled:
            host, port = split(section.listen)
            yield Listener((name, "listen"), section.listen, _host(host), port)
    if config.ros1.enabled is not False and config.ros1.embedded_uri:
        host, port = split(config.ros1.listen)
        yield Listener(("ros1", "listen"), config.ros1.listen, _host(host), port)
    yarp = config.yarp
    if yarp.enabled is not False and yarp.nameserver == "embedded" and yarp.place is not None:
        host, port = yarp.place
        yield Listener(("yarp", "address"), str(yarp.address), _host(host), port)


def listener_problems(document: Document, config: Config) -> list[Problem]:
    """Return a problem for each address whose port another listener uses.

    The problem is placed at the later of the two keys, or at the earlier one if only that is in the file.
    """
    problems: dict[KeyPath, Problem] = {}
    for earlier, other in combinations(listeners(config), 2):
        # the default of a key that the file lacks has no line there
        if other.path[:2] in document.values or earlier.path[:2] not in document.values:
            first, second = earlier, other
        else:
            first, second = other, earlier
        text = f"{second.text} uses the same port as {key_text(first.path)} ({first.text}); change one of the ports"
        if earlier.excludes(other):
            problems.setdefault(second.path, document.problem(second.path, text))
    return list(problems.values())


def _zenoh(path: KeyPath, endpoint: str) -> Iterator[Listener]:
    protocol, _, address = endpoint.partition("/")
    if transport := _TRANSPORTS.get(protocol):
        host, _, port = re.split(r"[?#]", address)[0].rpartition(":")
        yield Listener(path, endpoint, _host(host.strip("[]")), int(port), transport)


def _host(name: str) -> str:
    """Return an address in a uniform spelling."""
    if name == "localhost":
        return "127.0.0.1"
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        return name.lower()
