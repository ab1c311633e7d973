"""A name server with those behaviors of ``yarpserver`` (YARP 3.9 to 4.0) that differ from Midspan's name server.

The commands and carriers are those of `yarp_compat.naming.server`, which captures of yarpserver check. The differences
(from ``NameServiceOnTriples.cpp``, ``AllocatorOnTriples.cpp``, and observations of 3.9.1):

- Port numbers are assigned in order, starting two above the server's own port, without checking that they are free.
  A port that registers with an explicit number does not change this order.
- A port that registers again loses its properties.
- A restart clears all registrations, and the programs' ports do not register again.
- With ``--ros``, the server looks up unknown names at a ROS 1 master. When a port ``/topic+@/node`` is announced, the
  server registers the port with the master, under the address of the node's own port.
"""

from __future__ import annotations

from collections.abc import Container
from typing import Any
from urllib.parse import urlsplit
from xmlrpc.client import ServerProxy

from yarp_compat.naming.allocation import Allocator
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.registry import OLD, Command, PortRegistry, as_words
from yarp_compat.naming.server import NameServer
from yarp_compat.overriding import override
from yarp_compat.wire.contact import PortContact


class _Allocator(Allocator):
    """Assigns numbers without checking that they are free."""

    @override
    def number(self, name: str, taken: Container[int] = ()) -> int | None:
        return super().number(name)


class _Registry(PortRegistry):
    """The registered ports; ``master`` is the ROS 1 master of ``--ros``."""

    def __init__(self, server: PortContact, master: ServerProxy | None) -> None:
        super().__init__(server)
        self._master = master
        self._allocator = _Allocator(server.port)

    @override
    def _do_register(self, command: Command) -> list[Any]:
        command.events += self.remove([command.name(1)]).events
        return super()._do_register(command)

    @override
    def _do_query(self, command: Command) -> list[Any]:
        node = None if self.find(command.name(1)) else self._node_at_master(command.name(1))
        return [OLD, as_words(node)] if node else super()._do_query(command)

    @override
    def _do_announce(self, command: Command) -> list[Any]:
        self._call_master("register", command.name(1))
        return super()._do_announce(command)

    @override
    def _remove(self, command: Command, name: str, depth: int = 0) -> None:
        self._call_master("unregister", name)
        super()._remove(command, name, depth)

    def _node_at_master(self, name: str) -> PortContact | None:
        """Return the address of a ROS 1 node that the master lists."""
        code, _, uri = self._master.lookupNode("dummy_id", name) if self._master is not None else (0, "", "")
        url = urlsplit(uri if code == 1 else "")
        return PortContact(name, url.hostname, url.port or 0, "xmlrpc") if url.hostname else None

    def _call_master(self, verb: str, name: str) -> None:
        """Register or unregister the port of a node with the master."""
        topic, separator, node = name.partition("@")
        contact = self.find(node)
        if self._master is None or not separator or contact is None or self.find(name) is None:
            return
        method = f"{verb}{'Publisher' if topic.endswith('+') else 'Subscriber'}"
        type_name = (self._ports[name].properties.get("type") or ["*"])[:1] if verb == "register" else []
        getattr(self._master, method)(node, topic[:-1], *type_name, f"http://{contact.host}:{contact.port}/")


class RealNameServer(NameServer):
    """A server on loopback.

    Args:
        port: its TCP port.
        master: URI of the ROS 1 master, as with ``--ros``; "" for none.
    """

    def __init__(self, port: int, master: str = "") -> None:
        super().__init__(port=port, gc_seconds=0)
        self._master = ServerProxy(master) if master else None
        self.client = NameClient(self.address, timeout=40.0)
        self.endpoint = f"{self.address.host}:{port}"
        self.clear()

    @property
    def ports(self) -> dict[str, PortContact]:
        """The registered ports by name, without the server's own."""
        return {e.contact.name: e.contact for e in self.registry.entries() if e.contact != self.contact}

    def stored(self, name: str, key: str) -> list[str]:
        """Return the texts of a port's property; a client's ``get`` returns the values that YARP parses from them."""
        return next(e.properties.get(key, []) for e in self.registry.entries() if e.contact.name == name)

    def clear(self) -> None:
        """Clear all registrations, as a restart does."""
        with self._lock:
            self.registry = _Registry(self.contact, self._master)

    def stop(self) -> None:
        """Stop serving."""
        self.close()

    @override
    def close(self) -> None:
        super().close()
        if self._master is not None:
            self._master("close")()
