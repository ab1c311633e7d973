"""A name server with those behaviors of ``yarpserver`` (YARP 3.9 to 4.0) that differ from Midspan's name server.

The behaviors (from ``NameServiceOnTriples.cpp``, ``AllocatorOnTriples.cpp``, and observations of 3.9.1):

- Port numbers are assigned in order, starting two above the server's own port, without checking that they are free.
  A port that registers with an explicit number does not change this order.
- A name keeps its port number, even after it was unregistered.
- A restart clears all registrations, and the programs' ports do not register again.
- With ``--ros``, the server looks up unknown names at a ROS 1 master. When a port ``/topic+@/node`` is announced, the
  server registers the port with the master, under the address of the node's own port.
- Multicast groups are 224.1.1.3 and so on, each with one of those port numbers. Unregistering a port also unregisters
  the ports that it ``owns``.
"""

from __future__ import annotations

import contextlib
import socketserver
import threading
from typing import Any, Self
from urllib.parse import urlsplit
from xmlrpc.client import ServerProxy

from yarp_compat.naming.config import Address
from yarp_compat.wire.text import from_text

END = "*** end of message"


class RealNameServer:
    """A server of the text protocol on loopback.

    Args:
        port: TCP port of the server.
        master: URI of the ROS 1 master, as with ``--ros``; "" for none.
    """

    def __init__(self, port: int, master: str = "") -> None:
        self._master = ServerProxy(master) if master else None
        self.address = Address("127.0.0.1", port)
        self.ports: dict[str, tuple[str, int, str]] = {}
        self.properties: dict[tuple[str, str], list[Any]] = {}
        self._lock = threading.Lock()
        self.clear()
        outer = self

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                for request in self.rfile:
                    with contextlib.suppress(ConnectionError):  # the client may disconnect after the reply
                        self.wfile.write("".join(f"{line}\r\n" for line in self._reply(request.decode())).encode())

            def _reply(self, request: str) -> list[str]:
                """Reply in the carrier of the request: the name server's, or ``CONNACK`` as a port does."""
                carrier, _, remainder = request.strip().partition(" ")
                if carrier == "CONNACK":
                    return [f"Welcome {remainder}"]
                if carrier == "d":
                    return []
                answer = outer.answer(from_text(remainder.replace('"', "") if carrier == "NAME_SERVER" else request))
                return answer if carrier == "NAME_SERVER" else [*answer[:-1], "<ACK>"]

        class Server(socketserver.ThreadingTCPServer):
            daemon_threads = True
            allow_reuse_address = True

        self._server = Server(("127.0.0.1", port), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        if self._master is not None:
            self._master("close")()

    def clear(self) -> None:
        """Clear all registrations, as a restart does."""
        with self._lock:
            self.ports.clear()
            self.properties.clear()
            self._next, self._assigned = self.address.port + 2, dict[str, int]()
            self._groups = self._names = 0

    def answer(self, words: list[Any]) -> list[str]:
        """Return the lines of the reply to a command."""
        with self._lock:
            match words:
                case ["register", str(name), *contact]:
                    return [*self._registration(self._register(name, *contact)), END]
                case ["unregister", str(name)]:
                    self._unregister(name)
                    return [END]
                case ["query", str(name)]:
                    return [*(self._registration(name) or self._node_at_master(name)), END]
                case ["list", *arguments]:
                    prefix = str(arguments[0]) if arguments else ""
                    names = [name for name in sorted(self.ports) if name.startswith(prefix)]
                    return [*(line for name in names for line in self._registration(name)), END]
                case ["set", str(name), str(key), *values]:
                    self.properties[name, key] = values
                    return [f"port {name} property {key} = {' '.join(map(str, values))}", END]
                case ["bot", "get", str(name), str(key)]:
                    return [" ".join(map(str, self.properties.get((name, key), [])))]
                case ["announce", str(name), *_]:
                    self._call_master("register", name)
                    return ["[ok]"]
            return [END]

    def _register(self, name: str, carrier: Any = "...", host: Any = "...", number: Any = "...") -> str:
        if name == "...":
            self._names += 1
            name = f"/tmp/port/{self._names}"
        self._unregister(name)
        carrier = "tcp" if carrier == "..." else carrier
        if host == "..." and carrier == "mcast":
            self._groups += 1
            host = f"224.1.1.{self._groups + 2}"
        if not isinstance(number, int) or number <= 0:
            number = self._assigned.get(name, 0)
            if not number:
                number, self._next = self._next, self._next + 1
                self._assigned[name] = number
        self.ports[name] = ("127.0.0.1" if host == "..." else host, number, carrier)
        return name

    def _node_at_master(self, name: str) -> list[str]:
        """Return the registration line of a ROS 1 node that the master lists."""
        code, _, uri = self._master.lookupNode("dummy_id", name) if self._master is not None else (0, "", "")
        url = urlsplit(uri if code == 1 else "")
        return [f"registration name {name} ip {url.hostname} port {url.port} type xmlrpc"] if url.hostname else []

    def _call_master(self, verb: str, name: str) -> None:
        """Register or unregister the port of a node with the master."""
        topic, separator, node = name.partition("@")
        if self._master is None or not separator or name not in self.ports or node not in self.ports:
            return
        method = f"{verb}{'Publisher' if topic.endswith('+') else 'Subscriber'}"
        host, number, _ = self.ports[node]
        type_name = [str(value) for value in self.properties.get((name, "type"), ["*"])] if verb == "register" else []
        getattr(self._master, method)(node, topic[:-1], *type_name, f"http://{host}:{number}/")

    def _unregister(self, name: str) -> None:
        self._call_master("unregister", name)
        self.ports.pop(name, None)
        for key in [key for key in self.properties if key[0] == name]:
            values = self.properties.pop(key)
            for owned in values if key[1] == "owns" else []:
                self._unregister(str(owned))

    def _registration(self, name: str) -> list[str]:
        """Return the registration line of a port, or nothing if it is not registered."""
        if name not in self.ports:
            return []
        host, number, carrier = self.ports[name]
        return [f"registration name {name} ip {host} port {number} type {carrier}"]
