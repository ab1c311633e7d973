"""Embedded and external name servers, their restarts, several daemons, and the ports of a killed daemon."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.worker import NetworkBridge, make_edges
from bridge.adapters.yarp.network import DAEMON, OWNER, PRESENCE, YarpNetwork
from bridge.config.model import Config
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.adapters.yarp.conftest import Place
from tests.contract.hubside import HubSide
from tests.contract.side import WorkerProcess
from tests.contract.yarpside import YarpBridge
from tests.peers.daemon.exchange import exchange, until_all_receive
from tests.peers.hub.quick import QuickHub
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming import config as conf
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports import text_client

STRING = "std_msgs/String"


@pytest.fixture
def no_yarp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The path of a missing configuration folder, as on a machine without a yarp.conf."""
    folder = tmp_path / "yarp-config"
    monkeypatch.setenv("YARP_CONFIG_HOME", str(folder))
    monkeypatch.delenv("YARP_NAMESPACE", raising=False)
    return folder


def test_embedded_name_server_opens_if_no_other_answers(place: Place, no_yarp: Path) -> None:
    number = free_port()
    bridge = place.bridge(yarp={"nameserver": "auto", "address": f"127.0.0.1:{number}"})
    client = NameClient(Address("127.0.0.1", number))
    assert client.query("/root") is not None
    bridge.stop()
    with pytest.raises(OSError, match="does not answer"):
        client.list()
    assert not no_yarp.exists()


def test_address_of_the_embedded_name_server_is_written_to_yarp_conf(
    place: Place, no_yarp: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conf, "DEFAULT_PORT", free_port())
    place.bridge(yarp={"nameserver": "embedded", "address": None})
    assert (no_yarp / "yarp.conf").read_text() == f"127.0.0.1 {conf.DEFAULT_PORT} yarp\n"
    assert NameClient().list("/midspan/daemon")


def test_embedded_name_server_is_read_only_after_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    number = free_port()
    section = Config.model_validate({"yarp": {"nameserver": "embedded", "address": f"127.0.0.1:{number}"}}).yarp
    network = YarpNetwork(section, tmp_path)
    queries: list[str] = []
    query = network.naming.list
    monkeypatch.setattr(network.naming, "list", lambda: queries.append("list") or query())
    try:
        while network.list_ports() is None or len(queries) < 2:
            pass  # the first calls open the network and assign its ID
        network.list_ports()
        known, before = network.list_ports(), len(queries)
        assert network.list_ports() is known
        assert len(queries) == before
        NameClient(Address("127.0.0.1", number)).register("/late", "127.0.0.1", 5)
        assert "/late" in {contact.name for contact in network.list_ports() or []}
        assert network.naming.query("/late") == NameClient(Address("127.0.0.1", number)).query("/late")
        NameClient(Address("127.0.0.1", number)).unregister("/late")
        assert "/late" not in {contact.name for contact in network.list_ports() or []}
        assert network.naming.query("/late") is None
    finally:
        network.close()


def test_worker_waits_for_an_external_name_server(place: Place) -> None:
    place.names.stop()
    config, registry = place.config(), Registry()
    edge = make_edges("yarp", config, registry, place.folder)["yarp"]
    bridge = place.keep(NetworkBridge("yarp", edge, config, registry, print, diagnostics=False))
    assert bridge.health().state == "waiting"
    place.names.start()
    until(lambda: bridge.health().state == "running", "the network is joined", 10)


def test_invalid_host_of_the_name_server_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.adapters.yarp.network.PATIENCE", 0.0)
    config = Config.model_validate({"yarp": {"nameserver": "auto", "address": "a" * 70 + ":10000"}})
    network = YarpNetwork(config.yarp, tmp_path)
    assert [network.list_ports() for _ in range(3)] == [None] * 3
    assert "is not a host name" in network.trouble


def test_connections_survive_a_name_server_that_restarts_empty(place: Place) -> None:
    place.bridge()
    out = place.far.advertise("/kept", STRING)
    subscription = place.far.subscribe("/back", STRING)
    reader = place.port("/reader")
    reader.listen_to("/midspan/kept:o")
    program = place.program("/talker")
    back = program.advertise("/back", STRING)
    place.far.hub_publish_until(out, {"data": "before"}, lambda: reader.messages(1, 0.2))
    place.far.publish_until(program, back, {"data": "before"}, lambda: place.far.wait(subscription, 1, 0.2))
    place.names.stop()
    place.far.publish(out, {"data": "meanwhile"})
    until(lambda: ["meanwhile"] in reader.bottles(2, 0.2), "data flows without a name server")
    place.names.start()
    until(lambda: place.names.client.query("/midspan/kept:o"), "Midspan's ports are registered again", 10)
    until(lambda: place.names.client.get_property("/midspan/kept:o", OWNER), "the port has its owner mark", 10)
    place.far.publish(out, {"data": "after"})
    until(lambda: ["after"] in reader.bottles(3, 0.2), "data flows over the same connection")
    assert sum(values == ["after"] for values in reader.bottles()) == 1


def test_restart_after_a_kill_removes_stale_ports(place: Place) -> None:
    config = place.config()
    out = [place.far.advertise(topic, STRING) for topic in ("/one", "/two")]
    env = dict(os.environ)
    first = WorkerProcess("yarp", config, env)
    for topic in ("/one", "/two"):
        until(lambda t=topic: place.names.client.query(f"/midspan{t}:o"), "the ports are registered", 15)
    first.kill()
    assert place.names.client.query("/midspan/one:o")
    place.far.drop(out[0])
    second = WorkerProcess("yarp", config, env)
    try:
        until(lambda: not place.names.client.query("/midspan/one:o"), "the stale port is removed", 15)
        reader = place.port("/reader")
        reader.listen_to("/midspan/two:o")
        place.far.hub_publish_until(out[1], {"data": "again"}, lambda: reader.messages(1, 0.2))
    finally:
        second.stop()
    assert [c.name for c in place.names.client.list("/midspan")] == []


def test_yarp_program_gets_definitions_from_the_daemon(place: Place) -> None:
    place.bridge(name="robot")
    contact = place.names.client.list(PRESENCE.rstrip("/"))[0]
    # the bridge has joined as soon as this port is open, and then stores its name
    until(lambda: list(place.names.client.get_property(contact.name, DAEMON)) == ["robot"], "the name is stored")
    answer = text_client.ask(contact, ["definition", "geometry_msgs/Twist"])[0]
    assert answer.startswith("[ok]")
    assert "MSG: geometry_msgs/Vector3" in answer
    assert text_client.ask(contact, ["definition", "no_msgs/Thing"])[0].startswith("[fail]")


def test_a_lost_address_is_reported_until_it_returns(
    place: Place, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The ports stay registered under it, for instance after this machine has joined another Wi-Fi network."""
    caplog.set_level("INFO")
    place.bridge()
    lost = "this machine does not have the address 127.0.0.1 now"

    def warnings() -> list[str]:
        return [warning for warning in place.far.status()["warnings"] if lost in warning]

    assert warnings() == []
    with monkeypatch.context() as changed:
        changed.setattr("bridge.adapters.announced_address.has_address", lambda _ip: False)
        until(warnings, "the address is reported")
    until(lambda: not warnings(), "the warning ends")

    def lines() -> list[str]:
        return [text for text in caplog.messages if lost in text or "has the address again" in text]

    until(lambda: len(lines()) >= 2, "the return is logged, after the warning has ended")
    assert len(lines()) == 2


def test_port_name_of_another_program_is_a_warning(place: Place) -> None:
    other = place.port("/midspan/taken:o")
    place.port("/midspan/here/taken:o")
    bridge = place.bridge()
    out = place.far.advertise("/taken", STRING)
    warnings = until(
        lambda: [w for w in place.far.status()["warnings"] if "another program" in w], "it is reported", every=0.1
    )
    assert warnings[0].startswith("/midspan/taken:o: another program has a port of this name")
    other.stop()
    until(lambda: place.names.client.query("/midspan/taken:o"), "the port opens when the name is free", 10)
    place.far.drop(out)
    bridge.stop()


@pytest.mark.parametrize("hubs", ["one hub", "two hubs"])
def test_several_daemons_cause_no_loops_and_no_duplicates(place: Place, hubs: str) -> None:
    program = place.program("/program")
    subscription, out = program.subscribe("/both", STRING), program.advertise("/both", STRING)
    far = [place.far]

    def have_distinct_names() -> bool:
        """Return whether each daemon has its own ports. After a conflict, one daemon reopens its ports."""
        names = [contact.name for contact in place.names.client.list("/midspan")]
        ends = ("/both:o", "/both:i", "/both/nodes:i")
        return hubs == "one hub" or all(sum(name.endswith(end) for name in names) == 2 for end in ends)

    with QuickHub() as other:
        first = place.bridge(name="one")
        hub = {"listen": other.endpoint if hubs == "two hubs" else place.hubs.endpoint}
        state = place.folder / "two"
        second = place.keep(_second(place, hub, state))
        if hubs == "two hubs":
            far.append(HubSide(Hub.open(other.settings("far")), Registry()))
        try:
            from_far = exchange(program, out, subscription, far, have_distinct_names)
            if hubs == "one hub":  # the standby daemon takes over

                def states() -> list[str] | None:
                    current = [bridge.bridge.health().state for bridge in (first, second)]
                    return current if sorted(current) == ["running", "standby"] else None

                (first, second)[until(states, "one daemon is active").index("running")].stop()
                until_all_receive(
                    program, out, subscription, [(far[0], from_far[0], far[0].subscribe("/both", STRING))]
                )
            else:
                names = {c.name for c in place.names.client.list("/midspan")}
                assert {"/midspan/both:o"} < {n for n in names if n.endswith("/both:o")}
            second.stop()
        finally:
            for end in far[1:]:
                end.hub.close()


def _second(place: Place, hub: dict[str, Any], state: Path) -> Any:
    config = json.loads(place.config("two").model_dump_json(by_alias=True))
    return YarpBridge(type(place.config()).model_validate({**config, "hub": hub, "state": str(state)}))
