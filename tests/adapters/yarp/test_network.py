"""The name server, ours and the site's, killed and started again; several daemons; what a killed one leaves behind."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.worker import NetworkBridge, make_edges
from bridge.adapters.yarp.network import DAEMON, OWNER, PRESENCE, YarpNetwork
from bridge.config.model import Config
from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from tests.adapters.yarp.conftest import Place
from tests.contract.hubside import HubSide
from tests.contract.side import WorkerProcess
from tests.contract.yarpside import YarpBridge
from tests.support.exchange import exchange, until_all_receive
from tests.support.ports import free_port
from tests.support.quick_hub import QuickHub
from tests.support.wait import until
from yarp_compat.naming import config as conf
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports import text_client

STRING = "std_msgs/String"


@pytest.fixture
def no_yarp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without a yarp.conf."""
    folder = tmp_path / "yarp-config"
    monkeypatch.setenv("YARP_CONFIG_HOME", str(folder))
    monkeypatch.delenv("YARP_NAMESPACE", raising=False)
    return folder


def test_our_own_name_server_where_no_other_answers(place: Place, no_yarp: Path) -> None:
    number = free_port()
    bridge = place.bridge(yarp={"nameserver": "auto", "address": f"127.0.0.1:{number}"})
    client = NameClient(Address("127.0.0.1", number))
    assert client.query("/root") is not None
    bridge.stop()
    with pytest.raises(OSError, match="does not answer"):
        client.list()
    assert not no_yarp.exists()


def test_yarp_conf_says_where_our_name_server_is(place: Place, no_yarp: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conf, "DEFAULT_PORT", free_port())
    place.bridge(yarp={"nameserver": "embedded", "address": None})
    assert (no_yarp / "yarp.conf").read_text() == f"127.0.0.1 {conf.DEFAULT_PORT} yarp\n"
    assert NameClient().list("/midspan/daemon")


def test_our_own_name_server_is_asked_only_where_it_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    number = free_port()
    section = Config.model_validate({"yarp": {"nameserver": "embedded", "address": f"127.0.0.1:{number}"}}).yarp
    network = YarpNetwork(section, tmp_path)
    asked: list[str] = []
    ask = network.naming.list
    monkeypatch.setattr(network.naming, "list", lambda: asked.append("list") or ask())
    try:
        while network.list_ports() is None or len(asked) < 2:
            pass  # the first looks open it and give the network its name
        network.list_ports()
        known, before = network.list_ports(), len(asked)
        assert network.list_ports() is known
        assert len(asked) == before
        NameClient(Address("127.0.0.1", number)).register("/late", "127.0.0.1", 5)
        assert "/late" in {contact.name for contact in network.list_ports() or []}
        assert network.naming.query("/late") == NameClient(Address("127.0.0.1", number)).query("/late")
        NameClient(Address("127.0.0.1", number)).unregister("/late")
        assert "/late" not in {contact.name for contact in network.list_ports() or []}
        assert network.naming.query("/late") is None
    finally:
        network.close()


def test_the_sites_name_server_is_waited_for(place: Place) -> None:
    place.names.stop()
    config, registry = place.config(), Registry()
    edge = make_edges("yarp", config, registry, place.folder)["yarp"]
    crossing = place.keep(NetworkBridge("yarp", edge, config, registry, print, diagnostics=False))
    assert crossing.health().state == "waiting"
    place.names.start()
    until(lambda: crossing.health().state == "running", "it is joined", 10)


def test_a_name_server_that_returns_without_memory_costs_no_connection(place: Place) -> None:
    place.bridge()
    out = place.far.advertise("/kept", STRING)
    heard = place.far.subscribe("/back", STRING)
    reader = place.port("/reader")
    reader.listen_to("/midspan/kept:o")
    program = place.program("/talker")
    back = program.advertise("/back", STRING)
    place.far.hub_publish_until(out, {"data": "before"}, lambda: reader.messages(1, 0.2))
    place.far.publish_until(program, back, {"data": "before"}, lambda: place.far.wait(heard, 1, 0.2))
    place.names.stop()
    place.far.publish(out, {"data": "meanwhile"})
    until(lambda: ["meanwhile"] in reader.bottles(2, 0.2), "data flow without a name server")
    place.names.start()
    until(lambda: place.names.client.query("/midspan/kept:o"), "our ports are registered again", 10)
    until(lambda: place.names.client.get_property("/midspan/kept:o", OWNER), "and marked", 10)
    place.far.publish(out, {"data": "after"})
    until(lambda: ["after"] in reader.bottles(3, 0.2), "over the same connection")
    assert sum(values == ["after"] for values in reader.bottles()) == 1


def test_killed_and_started_again_leaves_no_ghosts(place: Place) -> None:
    config = place.config()
    out = [place.far.advertise(topic, STRING) for topic in ("/one", "/two")]
    env = dict(os.environ)
    first = WorkerProcess("yarp", config, env)
    for topic in ("/one", "/two"):
        until(lambda t=topic: place.names.client.query(f"/midspan{t}:o"), "its ports", 15)
    first.kill()
    assert place.names.client.query("/midspan/one:o")
    place.far.drop(out[0])
    second = WorkerProcess("yarp", config, env)
    try:
        until(lambda: not place.names.client.query("/midspan/one:o"), "what is left is removed", 15)
        reader = place.port("/reader")
        reader.listen_to("/midspan/two:o")
        place.far.hub_publish_until(out[1], {"data": "again"}, lambda: reader.messages(1, 0.2))
    finally:
        second.stop()
    assert [c.name for c in place.names.client.list("/midspan")] == []


def test_a_yarp_program_learns_definitions_from_the_daemon(place: Place) -> None:
    place.bridge(name="robot")
    contact = place.names.client.list(PRESENCE.rstrip("/"))[0]
    assert list(place.names.client.get_property(contact.name, DAEMON)) == ["robot"]
    answer = text_client.ask(contact, ["definition", "geometry_msgs/Twist"])[0]
    assert answer.startswith("[ok]")
    assert "MSG: geometry_msgs/Vector3" in answer
    assert text_client.ask(contact, ["definition", "no_msgs/Thing"])[0].startswith("[fail]")


def test_a_port_name_that_is_taken_is_told(place: Place) -> None:
    other = place.port("/midspan/taken:o")
    place.port("/midspan/here/taken:o")
    bridge = place.bridge()
    out = place.far.advertise("/taken", STRING)
    told = until(lambda: [w for w in place.far.status()["warnings"] if "another program" in w], "a warning", every=0.1)
    assert told[0].startswith("/midspan/taken:o: another program has a port of this name")
    other.stop()
    until(lambda: place.names.client.query("/midspan/taken:o"), "it is opened when the name is free", 10)
    place.far.drop(out)
    bridge.stop()


@pytest.mark.parametrize("hubs", ["one hub", "two hubs"])
def test_several_daemons_loop_nothing_and_bring_nothing_twice(place: Place, hubs: str) -> None:
    program = place.program("/program")
    heard, out = program.subscribe("/both", STRING), program.advertise("/both", STRING)
    far = [place.far]

    def named_apart() -> bool:
        """Whether both have ports of their own: of two that take one name at once, one opens them anew."""
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
            from_far = exchange(program, out, heard, far, named_apart)
            if hubs == "one hub":  # whoever stands by takes over
                states = [bridge.bridge.health().state for bridge in (first, second)]
                assert sorted(states) == ["running", "standby"]
                (first, second)[states.index("running")].stop()
                until_all_receive(program, out, heard, [(far[0], from_far[0], far[0].subscribe("/both", STRING))])
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
