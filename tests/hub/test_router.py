"""The router starts, reports its state, stops and returns."""

from __future__ import annotations

import signal
import socket
import threading
import time
from functools import partial

import pytest

from bridge.config.model import Config
from bridge.hub.errors import HubConfigError, HubError
from bridge.hub.node import Hub
from bridge.hub.router import RouterInfo, RouterWorker, port_held, probe_router
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree
from tests.peers.hub.endpoints import LATCHED, Subscriber, advertise, matched, see_each_other
from tests.peers.hub.network import ROUTER_PROGRAM, HubNetwork
from tests.support.ports import free_port
from tests.support.status_documents import check_document
from tests.support.wait import until
from tests.support.zenoh_router import open_router


def router_config(endpoint: str, router: object = "auto", **more: object) -> Config:
    return Config.model_validate({"name": "robot1", "hub": {"listen": endpoint, "router": router, **more}})


def test_router_runs_and_reports_its_status(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("bridge.hub.router._ANSWER_SECONDS", 40.0)  # no matter how slow the machine is
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    before = set(threading.enumerate())
    worker = RouterWorker()
    worker.start(router_config(endpoint))
    try:
        assert worker.health().state == "running"
        with Hub.open(HubNetwork(run=False).settings("a", router=endpoint)) as hub:
            until(lambda: hub.ask("status", {}, worker="router", timeout=0.5), "the router responds")
            (answer,) = hub.ask("status", {}, worker="router", timeout=40.0)
            assert answer.daemon == "robot1"
            check_document(answer.value, "router")
            (clock,) = hub.ask("time", {}, worker="router", timeout=40.0)
            assert abs(clock.value["time_ns"] - time.time_ns()) < 60e9, "for the doctor, also without sides"
            assert (answer.value["state"], answer.value["sessions"]) == ("running", 1)
            assert worker.health().text.startswith("1 session")
        assert worker.reload(router_config(endpoint))
        assert not worker.reload(router_config(endpoint, router=True))
    finally:
        worker.stop()
        worker.stop()
    assert not port_held(endpoint)
    until(lambda: set(threading.enumerate()) <= before, "the router's threads have ended")


def test_probe_identifies_the_router():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert probe_router(endpoint) is None
    with HubNetwork() as network:
        router = probe_router(network.endpoint, seconds=40.0)
        assert router is not None
        assert (router.mode, router.daemon, router.pid > 0) == ("router", "test", True)
    tree = session_tree(None, shared_memory=False, max_payload=MAX_PAYLOAD)
    for mode in ("router", "peer"):
        config = make_config(tree, {"mode": mode, "listen": {"endpoints": [endpoint]}})
        with open_router(config) as stranger:
            assert probe_router(endpoint, seconds=40.0) == RouterInfo(endpoint, str(stranger.zid()), mode)


def test_a_second_router_is_refused_or_stands_by(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("bridge.hub.router.probe_router", partial(probe_router, seconds=40.0))
    network = HubNetwork()
    with network:
        with pytest.raises(RuntimeError, match="is held by the router of Midspan daemon test"):
            RouterWorker().start(router_config(network.endpoint, router=True))
        standby = RouterWorker()
        standby.start(router_config(network.endpoint))
        try:
            health = standby.health()
            assert (health.state, "daemon test" in health.text) == ("standby", True)
            network.stop_router()
            until(lambda: standby.health().state == "running", "the standby router takes over")
            router = probe_router(network.endpoint, seconds=40.0)
            assert router is not None
            assert router.daemon == "robot1"
        finally:
            standby.stop()


def test_a_router_that_answers_late_is_used(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("bridge.hub.router._ROUTERS", {ROUTER_PROGRAM.name})
    with HubNetwork() as network:
        tried: list[float] = []

        def probe(endpoint: str, settings: object, seconds: float = 1.5) -> RouterInfo | None:
            network.signal_router(signal.SIGCONT if tried else signal.SIGSTOP)
            tried.append(seconds)
            return probe_router(endpoint, None, seconds if len(tried) == 1 else 40.0)

        monkeypatch.setattr("bridge.hub.router.probe_router", probe)
        standby = RouterWorker()
        standby.start(router_config(network.endpoint))
        try:
            assert (len(tried), standby.health().state) == (2, "standby")
        finally:
            standby.stop()


@pytest.mark.parametrize("router", [True, "auto"])
def test_occupied_port_is_rejected(router: object):
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        endpoint = f"tcp/127.0.0.1:{holder.getsockname()[1]}"
        with pytest.raises(RuntimeError, match="held by a program that is not zenoh; set hub"):
            RouterWorker().start(router_config(endpoint, router))


@pytest.mark.parametrize(
    ("hub", "reason"),
    [
        ({"listen": "unixsock-stream//proc/none/hub"}, "cannot listen on unixsock-stream//proc/none/hub"),
        ({"router_zenoh": {"nonsense": 1}}, "hub.router_zenoh: .*nonsense"),
    ],
)
def test_invalid_listen_endpoint_is_rejected(hub: dict[str, object], reason: str):
    config = {"name": "robot1", "hub": {"listen": f"tcp/127.0.0.1:{free_port()}", **hub}}
    with pytest.raises(RuntimeError, match=reason) as refused:
        RouterWorker().start(Config.model_validate(config))
    assert ".rs:" not in str(refused.value)


def test_session_opens_before_the_router_and_joins_it_later():
    network = HubNetwork(run=False)
    with network:
        start = time.monotonic()
        with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
            subscriber = Subscriber(b, "/map", LATCHED)
            advertise(a, "/map", LATCHED, "x")
            # detects only hangs
            assert time.monotonic() - start < 15
            assert [n.node for n in a.graph.nodes()] == ["a"]
            network.start_router()
            see_each_other(a, b)
            subscriber.expect("x")


def test_session_rejoins_a_restarted_router():
    with HubNetwork() as network, Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        # until then, they may see each other only through the router
        until(lambda: b.zid in a.neighbors() and a.zid in b.neighbors(), "the sessions have a direct link")
        subscriber = Subscriber(b, "/map", LATCHED)
        publisher = advertise(a, "/map", LATCHED, "one")
        subscriber.expect("one")
        network.stop_router()
        # the direct link still works
        publisher.put(b"two")
        subscriber.expect("one", "two")
        network.start_router()
        with Hub.open(network.settings("c")) as c:
            see_each_other(a, b, c)
            Subscriber(c, "/map", LATCHED).expect("two")


def test_clients_link_only_to_routers_and_reconnect():
    client = {"mode": "client"}
    with (
        HubNetwork(zenoh=client) as network,
        Hub.open(network.settings("a")) as a,
        Hub.open(network.settings("b")) as b,
    ):
        see_each_other(a, b)
        subscriber = Subscriber(b, "/map", LATCHED)
        publisher = advertise(a, "/map", LATCHED, "one")
        subscriber.expect("one")
        network.stop_router()
        until(lambda: len(a.graph.nodes()) == 1, "the sessions have lost each other")
        network.start_router()
        see_each_other(a, b)
        matched(publisher)
        publisher.put(b"two")
        until(lambda: "two" in subscriber.texts(), "data arrives again")
        assert subscriber.texts().count("one") == subscriber.texts().count("two") == 1


def test_a_client_without_its_router_is_refused():
    client = {"mode": "client", "connect": {"timeout_ms": 100}}
    with pytest.raises(HubError, match="cannot join the hub: Unable to connect"):
        Hub.open(HubNetwork(zenoh=client, run=False).settings("a"))


def test_a_bad_configuration_is_refused():
    with pytest.raises(HubConfigError, match="nonsense"):
        Hub.open(HubNetwork(zenoh={"nonsense": 1}, run=False).settings("a"))
