"""Which departures of servers end a client's calls; its endpoints and the graph are stand-ins."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

from bridge.adapters.ros2.rcl import ENCAPSULATION
from bridge.adapters.ros2.services.caller import Ros2Caller
from bridge.hub.endpoints.calls import CallError

OLD, NEW = (bytes.fromhex(f"{start:0<32}") for start in ("010faa", "010fbb"))
REQUEST, REPLY = ENCAPSULATION + b"\1", ENCAPSULATION + b"\2"
NUMBER = 7


class Handle(nullcontext[None]):
    """A client's inner object."""

    pointer = 1


class Called:
    """A client of /lamp, the servers that get its requests, and the results of its calls."""

    def __init__(self, recipient: bytes) -> None:
        sender = SimpleNamespace(
            has_server=lambda: True, obstacle=lambda: None, outdated=False, recipients=frozenset({recipient}),
            wait=lambda _servers: 0.0, send=lambda _request: NUMBER, close=lambda: None,
        )  # fmt: skip
        port = SimpleNamespace(handle=Handle(), sender=sender)
        self.graph = SimpleNamespace()
        self.list_server(OLD)
        context: Any = SimpleNamespace(
            participant=None, graph=self.graph, dds=SimpleNamespace(open_client=lambda *_: port),
            loop=SimpleNamespace(add=lambda _reader: None), later=SimpleNamespace(after=lambda *_, **__: None),
            processes=SimpleNamespace(has_ended=lambda _prefix: False),
        )  # fmt: skip
        service_class = SimpleNamespace(type_name="std_srvs/srv/SetBool")
        self.caller = Ros2Caller("/lamp", service_class, context, lambda _: None)
        self.results: list[bytes | CallError] = []
        self.caller.call(REQUEST, self.results.append)

    def list_server(self, gid: bytes) -> None:
        self.graph.snapshot = SimpleNamespace(servers={"/lamp": frozenset({gid})}, obstacles={})


def test_a_call_ends_when_its_server_leaves() -> None:
    called = Called(OLD)
    called.list_server(NEW)
    called.caller.refit()
    (result,) = called.results
    assert isinstance(result, CallError)
    assert "left before it answered" in str(result)


def test_a_call_of_a_restarted_server_that_the_snapshot_lacks_goes_on() -> None:
    """The graph is read with pauses: when the request is sent, the snapshot may still have the previous server."""
    called = Called(NEW)
    called.list_server(NEW)
    called.caller.refit()
    assert called.results == []
    called.caller._replied(NUMBER, REPLY)
    assert called.results == [REPLY]
