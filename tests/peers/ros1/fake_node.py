"""A ROS 1 node's slave API, which records the calls."""

from __future__ import annotations

import threading
from typing import Any

from bridge.adapters.ros1.xmlrpc import XmlRpcServer


class FakeNode:
    """A slave API that records the calls, and responds only while ``answers`` is set."""

    def __init__(self, code: int = 1) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.answers = threading.Event()
        self.answers.set()
        self._code = code
        names = ("publisherUpdate", "paramUpdate", "shutdown", "getPid")
        self._server = XmlRpcServer({name: lambda *params, name=name: self._called(name, params) for name in names})
        self._server.start()
        self.api = f"http://127.0.0.1:{self._server.port}/"

    def _called(self, name: str, params: tuple[Any, ...]) -> list[Any]:
        self.answers.wait(30)
        self.calls.append((name, *params[1:]))
        return [self._code, "", 0]

    def close(self) -> None:
        self.answers.set()
        self._server.close()
