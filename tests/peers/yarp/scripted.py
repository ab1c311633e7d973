"""A scripted peer that records what it receives."""

from __future__ import annotations

import contextlib
import socket
import threading
from types import TracebackType
from typing import Self


class Scripted:
    """A peer on loopback that plays the next script for each connection.

    Args:
        scripts: for each connection, pairs of the number of lines to read and the reply. The peer stays silent for
            None, and closes the connection for b"".
    """

    def __init__(self, *scripts: list[tuple[int, bytes | None]]) -> None:
        self._scripts = list(scripts)
        self.received: list[bytes] = []
        self._sock = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._sock.getsockname()[1]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, err: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        with contextlib.suppress(OSError):
            socket.create_connection(("127.0.0.1", self.port), 1.0).close()
        self._thread.join()
        self._sock.close()

    def _run(self) -> None:
        for script in self._scripts:
            peer, _ = self._sock.accept()
            if self._stop.is_set():
                peer.close()
                return
            with peer:
                self._talk(peer, script)

    def _talk(self, peer: socket.socket, script: list[tuple[int, bytes | None]]) -> None:
        self.received.append(b"")
        with peer.makefile("rb") as lines:
            for count, answer in script:
                for _ in range(count):
                    self.received[-1] += lines.readline()
                if answer is None:
                    self._stop.wait(20.0)
                elif answer:
                    with contextlib.suppress(OSError):
                        peer.sendall(answer)
                else:
                    return
