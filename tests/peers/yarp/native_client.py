"""An RPC client that behaves like YARP's C++ library (``yarp::os::RpcClient``, 3.9), on plain sockets.

The client connects once, on request (``PortCore.cpp``, 3.9 and 4.0). It detects a closed connection only when it
writes: that call fails, the connection is removed, and the client never reconnects by itself. Until then the client
lists the dead connection. An ``[add]`` replaces an earlier connection between the same ports.
"""

from __future__ import annotations

import contextlib
import socket
import threading

from yarp_compat.naming.client import NameClient

_ACK = bytes.fromhex("59410000000052 50")
_HEAD = bytes.fromhex("59410a0000005250 0201ffffffffffffffff 08000000")
_CALL = bytes.fromhex("00000000 7e640001")


class NativeClient:
    """A registered and listening port that makes calls.

    Args:
        name: the port's name.
        naming: the name server.
        seconds: timeout for replies.
    """

    def __init__(self, name: str, naming: NameClient, seconds: float = 10.0) -> None:
        self.name, self._naming, self._seconds = name, naming, seconds
        self._server = socket.create_server(("127.0.0.1", 0))
        self._lock = threading.Lock()
        self._link: socket.socket | None = None
        self._target = ""
        naming.register(name, "127.0.0.1", self._server.getsockname()[1])
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def connect(self, target: str) -> bool:
        """Connect to a port once, like ``Network::connect``, and return whether that succeeded."""
        contact = self._naming.query(target)
        if contact is None:
            return False
        with contextlib.suppress(OSError):
            link = socket.create_connection((contact.host, contact.port), self._seconds)
            name = self.name.encode() + b"\0"
            link.sendall(bytes.fromhex("5941e41e00005250") + len(name).to_bytes(4, "little") + name)
            if len(link.recv(8, socket.MSG_WAITALL)) < 8:  # the port is closing (``TcpCarrier::expectReplyToHeader``)
                link.close()
                return False
            with self._lock:
                self._drop()
                self._link, self._target = link, target
            return True
        return False

    def call(self, request: bytes) -> bytes | None:
        """Call with a request's payload; return the reply's payload, or None if the call failed."""
        with self._lock:  # ``PortCore::sendHelper`` also holds a lock, so administrative commands wait
            if self._link is None:
                return None
            try:
                sizes = len(request).to_bytes(4, "little") + bytes(4)
                self._link.sendall(_HEAD + sizes + _CALL + request)
                reply = b""
                while not reply.endswith(_ACK):
                    reply += _some(self._link)
            except OSError:
                self._drop()
                return None
            return reply.removesuffix(_ACK)

    def close(self) -> None:
        """Close and unregister the port."""
        self._server.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._server.close()
        self._drop()
        self._naming.unregister(self.name)

    def _drop(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _listen(self) -> None:
        while True:
            try:
                peer, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=[peer], daemon=True).start()

    def _serve(self, peer: socket.socket) -> None:
        """Reply to a tool's administrative commands, over ``text_ack``."""
        with peer, contextlib.suppress(OSError), peer.makefile("rwb") as lines:
            peer.settimeout(self._seconds)
            lines.write(lines.readline().replace(b"CONNACK", b"Welcome"))
            lines.flush()
            while (key := lines.readline().strip()) not in (b"", b"q"):
                command = lines.readline().decode().replace('"', "").split() if key == b"a" else []
                lines.write(self._administer(command).encode() + b"\r\n<ACK>\r\n")
                lines.flush()

    def _administer(self, command: list[str]) -> str:
        if command[:1] == ["[add]"]:
            target = "/" + command[1].partition("//")[2]
            done = self.connect(target)
            return f'0 "Added connection from {self.name} to {target}"' if done else f'-1 "no {target}"'
        with self._lock:
            return self._reply(command)

    def _reply(self, command: list[str]) -> str:
        if command[:2] == ["[list]", "[out]"]:
            linked = self._link is not None and self._target in command[2:]
            return f'(from "{self.name}") (to "{self._target}") (carrier tcp)' if linked else ""
        return '1 "" 4711' if command == ["getPid"] else '[fail] "send [help] for list of valid commands"'


def _some(link: socket.socket) -> bytes:
    data = link.recv(1 << 16)
    if not data:
        raise ConnectionResetError
    return data
