"""A dialect over TLS reports why one end refuses the other's certificate."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from bridge.hub.security import endpoints
from bridge.hub.security.certificates import Authority
from bridge.hub.security.handshake import HostPort, Identity, attempt
from tests.adapters.zenoh.conftest import Place
from tests.contract.zenohside import ZenohBridge
from tests.peers.daemon.midspan import MIDSPAN
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until
from tests.support.zenoh_router import open_router

CURE = "compare the files in transport/link/tls of zenoh.zenoh with those of the other machine"


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endpoints, "POLL_SECONDS", 0.1)
    monkeypatch.setattr(endpoints, "FIRST_SECONDS", 0.5)
    monkeypatch.setattr(endpoints, "TEST_SECONDS", 1.0)


def tls(folder: Path, fleet: str) -> dict[str, Any]:
    own = folder / fleet
    names = {"root_ca_certificate": own / "ca.pem"} | {
        f"{end}_{part}": own / f"robot1.{suffix}"
        for end in ("listen", "connect")
        for part, suffix in (("certificate", "pem"), ("private_key", "key"))
    }
    return {"link": {"tls": {name: str(file) for name, file in names.items()} | {"enable_mtls": True}}}


@pytest.fixture
def endpoint(tmp_path: Path) -> Iterator[str]:
    """The endpoint of a router over TLS, with certificates of the authority ``a``."""
    for fleet in ("a", "b"):
        Authority(tmp_path / fleet).make()
        Authority(tmp_path / fleet).issue("robot1", ["127.0.0.1"])
    place = f"tls/127.0.0.1:{free_port()}"
    scouting = {"multicast": {"enabled": False}}
    tree = {"mode": "router", "scouting": scouting, "listen": {"endpoints": [place]}, "transport": tls(tmp_path, "a")}
    session = open_router(zenoh.Config.from_json5(json.dumps(tree)))
    yield place
    session.close()  # type: ignore[no-untyped-call]


def start(place: Place, monkeypatch: pytest.MonkeyPatch, settings: dict[str, Any]) -> Any:
    """Start a dialect, without waiting for its network, and return its bridge."""
    monkeypatch.setattr("tests.contract.zenohside.until", lambda *_: None)
    config = place.config(zenoh={"zenoh": settings, "dialects": [{"dialect": "ros2dds"}]})
    return place.keep(ZenohBridge(config)).bridges[0]


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_a_refused_certificate_is_reported(
    place: Place, endpoint: str, tmp_path: Path, mode: str,
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    settings = {"mode": mode, "connect": {"endpoints": [endpoint]}, "transport": tls(tmp_path, "b")}
    bridge = start(place, monkeypatch, settings)

    def refused() -> Any:
        health = bridge.health()
        return health if "is from another authority" in health.text else None

    health = until(refused, "the state gives the reason")
    assert health.state == "waiting"
    assert endpoint in health.text
    assert CURE in health.text
    until(lambda: health.text in place.answer(bridge.name)["warnings"], "it is a warning", every=0.1)

    def lines() -> list[str]:
        texts = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
        return [text for text in texts if endpoint in text]

    until(lambda: any(CURE in line for line in lines()), "it is logged, after the state has it")
    assert all(line.startswith(f"{bridge.name}: ") for line in lines())


def test_an_accepted_certificate_is_not_reported(
    place: Place, endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = {"connect": {"endpoints": [endpoint]}, "transport": tls(tmp_path, "a")}
    bridge = start(place, monkeypatch, settings)
    until(lambda: bridge.health().state == "running", "the dialect joins")
    # a test connection that a busy machine delayed may be reported until the next one
    until(lambda: place.answer(bridge.name)["warnings"] == [], "the warning ends", every=0.1)


def test_a_machine_that_a_dialect_refuses_is_logged(place: Place, tmp_path: Path) -> None:
    """The refusal is only in zenoh's log, which each worker of a daemon reads."""
    for fleet in ("a", "b"):
        Authority(tmp_path / fleet).make()
        Authority(tmp_path / fleet).issue("robot1", ["127.0.0.1"])
    listen = f"tls/127.0.0.1:{free_port()}"
    document = {
        "name": "here",
        "state": str(tmp_path / "state"),
        "hub": {"listen": place.hubs.endpoint, "router": "auto"},
        **{side: {"enabled": False} for side in ("ros1", "ros2", "yarp")},
        "zenoh": {
            "dialects": [{"dialect": "ros2dds"}],
            "zenoh": {"listen": {"endpoints": [listen]}, "transport": tls(tmp_path, "a")},
        },
    }
    file = tmp_path / "midspan.json"
    file.write_text(json.dumps(document))
    daemon = place.keep(Process([*MIDSPAN, "run", "--config", str(file)]))
    until(lambda: "zenoh: waiting for its network" in daemon.output(), "the dialect listens", 60)
    server = HostPort.of(listen)
    assert server is not None
    attempt(server, Identity(tmp_path / "a/ca.pem", tmp_path / "b/robot1.pem", tmp_path / "b/robot1.key"))
    text = f"zenoh: zenoh_ros2dds: listen {listen}: a machine"
    until(lambda: text in daemon.output(), "the worker logs the refusal", 20)
    (line,) = [line for line in daemon.output().splitlines() if text in line]
    assert " warning " in line
    assert line.endswith(f"is refused: its certificate is from another authority; {CURE}")
    assert "Unable to open listener" not in daemon.output(), "the router's port is in use, which is normal here"
