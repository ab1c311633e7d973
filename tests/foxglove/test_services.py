"""The hub's services are announced to the app, which calls them with CDR."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.foxglove import services
from bridge.messages.errors import MessageTypeError
from bridge.messages.json import CallCodec
from bridge.messages.registry import Registry
from tests.foxglove.conftest import Desk
from tests.foxglove.test_publishing import DRIVE
from tests.peers.browser.foxglove_app import App
from tests.support.wait import until

SET_BOOL = "std_srvs/srv/SetBool"


@pytest.fixture
def driven(desk: Desk) -> Desk:
    desk.open_with(**DRIVE)
    return desk


@pytest.fixture
def codec() -> CallCodec:
    return CallCodec(Registry(), SET_BOOL)


def failure(app: App, call: int) -> str:
    """Return the reason for a failed call."""

    def failed() -> str:
        service = (text_ for text_ in app.texts if text_["op"] == "serviceCallFailure" and text_["callId"] == call)
        return str(next(service, {}).get("message", ""))

    return app.until(failed, "the call fails")


def test_services_are_announced_with_their_definitions_and_withdrawn(driven: Desk) -> None:
    with driven.app() as app:
        driven.far.serve("/light", "std_srvs/SetBool", reply={"success": True, "message": "on"})
        driven.far.serve("/node/get_parameters", "rcl_interfaces/GetParameters", reply={})
        service = app.until(lambda: app.services.get("/light"), "the service is announced")
        assert service["type"] == SET_BOOL
        assert (service["request"]["encoding"], service["request"]["schemaEncoding"]) == ("cdr", "ros2msg")
        assert "bool data" in service["request"]["schema"]
        assert "string message" in service["response"]["schema"]
        assert driven.status()["services"] == 1
        driven.far.servers.pop("/light").close()
        app.until(lambda: not app.services, "the service is withdrawn")


def test_a_definition_that_no_worker_had_is_requested_again(driven: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """The worker that has it may be starting, and the graph may not change any more."""
    monkeypatch.setattr(services, "REPEAT_SECONDS", 0.0)
    registry, asked = driven.live.host.node.registry, list[str]()
    schemas = registry.service_schemas

    def once_learned(name: str, type_hash: str = "") -> Any:
        if name == SET_BOOL and len(asked) < 4:
            raise MessageTypeError(f"unknown type {name}")
        return schemas(name, type_hash)

    monkeypatch.setattr(registry, "service_schemas", once_learned)
    monkeypatch.setattr(services, "learn", lambda _hub, _registry, name, _hash: asked.append(name))
    driven.far.serve("/light", "std_srvs/SetBool", reply={"success": True, "message": "on"})
    with driven.app() as app:
        app.until(lambda: app.services.get("/light"), "the service is announced once its definition is known")


def test_a_call_receives_its_reply(driven: Desk, codec: CallCodec) -> None:
    driven.far.serve("/light", "std_srvs/SetBool", reply={"success": True, "message": "on"})
    with driven.app() as app:
        call = app.call("/light", codec.request({"data": True}))
        reply = app.until(lambda: app.replies.get(call), "the reply arrives")
        assert codec.response_value(reply) == {"success": True, "message": "on"}
        until(lambda: not driven.far.hub.graph.clients("/light"), "the Foxglove server withdraws its client")


def test_failed_calls_are_reported(driven: Desk, codec: CallCodec, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "CALL_SECONDS", 0.3)
    serving = driven.far.serve("/light", "std_srvs/SetBool", held=True)
    with driven.app() as app:
        assert "has not answered in 0.3 s" in failure(app, app.call("/light", codec.request({"data": True})))
        monkeypatch.setattr(services, "CALL_SECONDS", 30.0)
        assert "CallRefusedError" in failure(app, app.call("/light", b"\0\1\0"))
        assert "Unsupported encoding" in failure(app, app.call("/light", b"{}", "json"))
        until(lambda: serving.abandoned == 1, "the service's server is notified of the abandoned call")
        calls = [app.call("/light", codec.request({"data": True})) for _ in range(services.MOST_CALLS)]
        assert len(serving.requests(1 + services.MOST_CALLS)) == 1 + services.MOST_CALLS
        assert "16 calls are pending" in failure(app, app.call("/light", codec.request({"data": True})))
        serving.release()
        app.until(lambda: all(call in app.replies for call in calls), "the other calls have replies")


def test_a_watching_client_may_not_call(desk: Desk) -> None:
    desk.far.serve("/light", "std_srvs/SetBool", reply={"success": True, "message": "on"})
    with desk.app() as app:
        app.until(lambda: app.texts, "the client is accepted")
        desk.far.advertise("/said", "std_msgs/String")
        app.channel("/said")
        assert not app.services
        app.services["/light"] = {"id": 1}
        assert "does not support services" in failure(app, app.call("/light", b""))
