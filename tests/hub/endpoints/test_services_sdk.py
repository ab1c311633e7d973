"""Services between the hub and zenoh-ros2-sdk, an independent program in a separate process, in both directions."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.hub.endpoints import calls
from bridge.hub.endpoints.calls import Abandon, CallError, Done
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from tests.peers.hub.network import HubNetwork
from tests.peers.peer import Peer
from tests.support.wait import until

SERVICE = "std_srvs/srv/SetBool"
REGISTRY = Registry()
HASH = REGISTRY.service_ros2(SERVICE).type_id
REQUEST, RESPONSE = REGISTRY.service_schemas(SERVICE)


@pytest.fixture
def sdk(network: HubNetwork) -> Iterator[Peer]:
    with network.sdk_peer() as peer:
        yield peer


@pytest.fixture
def hub(network: HubNetwork) -> Iterator[Hub]:
    with Hub.open(network.settings("midspan_test")) as hub:
        yield hub


def asked(hub: Hub, request: dict[str, Any], seconds: float = 20.0) -> Any:
    """Return the reply to a call of /do, or the error's text."""
    client = hub.client("/do", SERVICE, HASH)
    until(lambda: client.ready, "the server is seen")
    ended, ends = threading.Event(), list[bytes | CallError]()
    client.call(MessageWriter(REQUEST).message(request), lambda result: (ends.append(result), ended.set()))
    assert ended.wait(seconds), "the call has not ended"
    client.close()
    (result,) = ends
    return str(result) if isinstance(result, CallError) else MessageReader(RESPONSE, result).message()


def test_sdk_server_answers_our_client(hub: Hub, sdk: Peer) -> None:
    served = sdk.ask("serve", service="/do", type="std_srvs/SetBool", reply={"success": True, "message": "it is ön"})
    assert served["hash"] == HASH
    until(lambda: hub.graph.servers("/do"), "the SDK's server is seen")
    (server,) = hub.graph.servers("/do")
    assert (server.node, server.type_name, server.type_hash, server.origin) == ("sdk_server", SERVICE, HASH, None)
    assert asked(hub, {"data": True}) == {"success": True, "message": "it is ön"}
    assert asked(hub, {"data": False})["success"] is True
    assert sdk.ask("requests", id=served["id"], count=2)["requests"] == [{"data": True}, {"data": False}]
    sdk.drop(served["id"])
    until(lambda: not hub.graph.servers("/do"), "the server is removed from the graph")


def test_sdk_server_error_reaches_our_client(hub: Hub, sdk: Peer) -> None:
    sdk.ask("serve", service="/do", type="std_srvs/SetBool", error="the arm is stuck")
    assert asked(hub, {}) == "Service callback error: the arm is stuck"


def test_dead_sdk_server_ends_our_call(hub: Hub, sdk: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calls, "_AT_ONCE", 40.0)  # the server dies soon after the request
    served = sdk.ask("serve", service="/do", type="std_srvs/SetBool", held=True)
    client = hub.client("/do", SERVICE, HASH)
    until(lambda: client.ready, "the server is seen")
    ended, ends = threading.Event(), list[bytes | CallError]()
    client.call(MessageWriter(REQUEST).message({}), lambda result: (ends.append(result), ended.set()))
    assert sdk.ask("requests", id=served["id"])["requests"]
    sdk.signal(9)
    assert ended.wait(20)
    assert str(ends[0]) == "the server of /do left before it answered"


def test_our_server_answers_an_sdk_client(hub: Hub, sdk: Peer) -> None:
    requests: list[dict[str, Any]] = []

    def serve(request: bytes, done: Done) -> Abandon:
        requests.append(MessageReader(REQUEST, request).message())
        on = requests[-1]["data"]
        done(MessageWriter(RESPONSE).message({"success": on, "message": "hällo"}) if on else CallError("never off"))
        return lambda: None

    hub.server("/do", SERVICE, HASH, serve)

    def result(*, on: bool) -> dict[str, Any]:
        called = sdk.ask("call", service="/do", type="std_srvs/SetBool", request={"data": on}, timeout=2.0)
        return sdk.ask("result", id=called["id"])

    # the SDK calls at once, although zenoh may not know the server yet
    until(lambda: result(on=True)["reply"] == {"success": True, "message": "hällo"}, "the server replies", 30)

    def refused() -> bool:  # on a busy machine, the SDK may give up before the reply arrives
        ended = result(on=False)
        assert (ended["done"], ended["reply"]) == (True, None)
        return "Service call failed: never off" in sdk.output()

    until(refused, "the error arrives", 30)
    assert {"data": False} in requests
