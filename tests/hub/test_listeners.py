"""A session joins the hub although a listener in the user's settings cannot be opened."""

from __future__ import annotations

import socket
from typing import Any

import pytest
import zenoh

from bridge.hub import listeners
from bridge.hub.listeners import open_hub_session
from bridge.hub.zenoh_config import LISTENERS, make_config, router_tree, session_tree
from tests.support.ports import free_port

FOREIGN = "203.0.113.7"  # of TEST-NET-3 (RFC 5737), which no machine has


@pytest.fixture(autouse=True)
def _fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listeners, "_closed", {})
    monkeypatch.setattr(listeners, "_absent", {})


def open_and_close(user: dict[str, Any]) -> None:
    config = make_config(session_tree(None, shared_memory=False, max_payload=1 << 20), user)
    open_hub_session(config).close()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("place", [f"{FOREIGN}:PORT", "no-such-host.invalid:PORT", "127.0.0.1:PORT#iface=none0"])
def test_a_session_opens_without_a_listener_that_fails(place: str, caplog: pytest.LogCaptureFixture) -> None:
    works, fails = f"tcp/127.0.0.1:{free_port()}", f"tcp/{place.replace('PORT', str(free_port()))}"
    open_and_close({"listen": {"endpoints": [works, fails]}})
    assert f"no program can connect at {fails} (hub.zenoh): " in listeners.trouble()
    assert listeners.trouble() in caplog.text


@pytest.mark.parametrize("address", [FOREIGN, "[2001:db8::7]"])
def test_an_address_that_the_machine_gets_later_is_noticed(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fails = f"tcp/{address}:{free_port()}"
    open_and_close({"listen": {"endpoints": [fails, f"tcp/no-such-host.invalid:{free_port()}"]}})
    assert listeners.arrived() == ""
    asked: list[str] = []
    monkeypatch.setattr(listeners, "has_address", lambda address: bool(asked.append(address) or True))
    assert listeners.arrived() == fails
    assert asked == [address.strip("[]")]


def test_a_port_that_becomes_free_is_not_an_address_that_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    """All workers have the same settings, and only one of them can have a port."""
    monkeypatch.setattr(listeners, "_is_open", lambda _endpoint: False)  # as if another process had the port
    with socket.create_server(("127.0.0.1", 0)) as taken:
        open_and_close({"listen": {"endpoints": [f"tcp/127.0.0.1:{taken.getsockname()[1]}"]}})
        assert "no program can connect at" in listeners.trouble()
    assert listeners.arrived() == ""


def test_listeners_that_open_are_not_reported() -> None:
    open_and_close({"listen": {"endpoints": {"peer": [f"tcp/127.0.0.1:{free_port()}"]}}})
    assert listeners.trouble() == ""


@pytest.mark.parametrize("endpoints", [list(LISTENERS), [f"tcp/{FOREIGN}:7447"]])
def test_a_session_with_other_mistakes_does_not_open(endpoints: list[str]) -> None:
    password = {"user": "a", "password": "b", "dictionary_file": "/etc"}
    with pytest.raises(zenoh.ZError, match="Is a directory"):
        open_and_close({"listen": {"endpoints": endpoints}, "transport": {"auth": {"usrpwd": password}}})
    assert listeners.trouble() == ""


def test_a_router_without_its_listener_does_not_open() -> None:
    config = make_config(router_tree([f"tcp/{FOREIGN}:{free_port()}"], max_payload=1 << 20), None)
    with pytest.raises(zenoh.ZError, match="Cannot assign"):
        open_hub_session(config)
