"""A name server as the real ``yarpserver`` of YARP 3.9 to 4.0 behaves where ours does not.

What it copies of that one (``NameServiceOnTriples.cpp``, ``AllocatorOnTriples.cpp``, and what was seen of 3.9.1):

- port numbers are given out from two above its own on and never tried; a port that says its number moves nothing;
- a name keeps the number that it was given, also after it was unregistered;
- a restart forgets all of that, and the programs' ports do not register again;
- with ``--ros`` it asks a ROS 1 master for names that it does not know, and registers ports ``/topic+@/node`` there
  when they are announced, under the address of the node's own port;
- multicast groups are 224.1.1.3 and so on, each with one of those numbers; what a port ``owns`` goes with it.
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
    """Serves the text protocol on loopback.

    Args:
        port: its own port number.
        master: URI of the ROS 1 master that it was given with ``--ros``.
    """

    def __init__(self, port: int, master: str = "") -> None:
        self._master = ServerProxy(master) if master else None
        self.address = Address("127.0.0.1", port)
        self.ports: dict[str, tuple[str, int, str]] = {}
        self.properties: dict[tuple[str, str], list[Any]] = {}
        self._lock = threading.Lock()
        self.forget()
        outer = self

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                for line in self.rfile:
                    with contextlib.suppress(ConnectionError):  # who has its answer leaves
                        self.wfile.write("".join(f"{one}\r\n" for one in self._reply(line.decode())).encode())

            def _reply(self, line: str) -> list[str]:
                """Reply in the carrier of the name server, or in that of a port, ``CONNACK``."""
                carrier, _, rest = line.strip().partition(" ")
                if carrier == "CONNACK":
                    return [f"Welcome {rest}"]
                if carrier == "d":
                    return []
                answer = outer.answer(from_text(rest.replace('"', "") if carrier == "NAME_SERVER" else line))
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

    def forget(self) -> None:
        """What a restart does."""
        with self._lock:
            self.ports.clear()
            self.properties.clear()
            self._next, self._kept = self.address.port + 2, dict[str, int]()
            self._groups = self._names = 0

    def answer(self, words: list[Any]) -> list[str]:
        """The lines that answer a command."""
        with self._lock:
            match words:
                case ["register", str(name), *given]:
                    return [*self._shown(self._register(name, *given)), END]
                case ["unregister", str(name)]:
                    self._unregister(name)
                    return [END]
                case ["query", str(name)]:
                    return [*(self._shown(name) or self._asked(name)), END]
                case ["list", *prefix]:
                    at = str(prefix[0]) if prefix else ""
                    return [
                        line for name in sorted(self.ports) if name.startswith(at) for line in self._shown(name)
                    ] + [END]
                case ["set", str(name), str(key), *values]:
                    self.properties[name, key] = values
                    return [f"port {name} property {key} = {' '.join(map(str, values))}", END]
                case ["bot", "get", str(name), str(key)]:
                    return [" ".join(map(str, self.properties.get((name, key), [])))]
                case ["announce", str(name), *_]:
                    self._tell_master("register", name)
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
            number = self._kept.get(name, 0)
            if not number:
                number, self._next = self._next, self._next + 1
                self._kept[name] = number
        self.ports[name] = ("127.0.0.1" if host == "..." else host, number, carrier)
        return name

    def _asked(self, name: str) -> list[str]:
        """What the master says of a name."""
        code, _, uri = self._master.lookupNode("dummy_id", name) if self._master is not None else (0, "", "")
        at = urlsplit(uri if code == 1 else "")
        return [f"registration name {name} ip {at.hostname} port {at.port} type xmlrpc"] if at.hostname else []

    def _tell_master(self, what: str, name: str) -> None:
        topic, at, node = name.partition("@")
        if self._master is None or not at or name not in self.ports or node not in self.ports:
            return
        method = f"{what}{'Publisher' if topic.endswith('+') else 'Subscriber'}"
        host, number, _ = self.ports[node]
        type_name = [str(value) for value in self.properties.get((name, "type"), ["*"])] if what == "register" else []
        getattr(self._master, method)(node, topic[:-1], *type_name, f"http://{host}:{number}/")

    def _unregister(self, name: str) -> None:
        self._tell_master("unregister", name)
        self.ports.pop(name, None)
        for key in [key for key in self.properties if key[0] == name]:
            values = self.properties.pop(key)
            for owned in values if key[1] == "owns" else []:
                self._unregister(str(owned))

    def _shown(self, name: str) -> list[str]:
        if name not in self.ports:
            return []
        host, number, carrier = self.ports[name]
        return [f"registration name {name} ip {host} port {number} type {carrier}"]
