"""TLS, access control and other network topologies, all set by zenoh's configuration."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from bridge.hub.errors import HubError
from bridge.hub.node import Hub
from bridge.hub.router import probe_router
from tests.peers.hub.endpoints import LATCHED, Subscriber, advertise, matched, see_each_other
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until


def openssl(folder: Path, *args: str) -> None:
    subprocess.run(["openssl", *args], cwd=folder, check=True, capture_output=True)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority, and certificates that it signed for the router and two robots."""
    folder = tmp_path_factory.mktemp("tls")
    for name in ("authority", "stranger"):
        key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-keyout", f"{name}.key")
        openssl(folder, "req", "-x509", *key, "-out", f"{name}.pem", "-subj", f"/CN={name}", "-days", "2")
    for name in ("router", "robot1", "robot2"):
        key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-keyout", f"{name}.key")
        openssl(folder, "req", *key, "-out", f"{name}.csr", "-subj", f"/CN={name}")
        (folder / "names").write_text("subjectAltName=IP:127.0.0.1,DNS:localhost\n")
        signer = ("-CA", "authority.pem", "-CAkey", "authority.key", "-CAcreateserial", "-extfile", "names")
        openssl(folder, "x509", "-req", "-in", f"{name}.csr", "-out", f"{name}.pem", "-days", "2", *signer)
    return folder


def tls(folder: Path, name: str, authority: str = "authority") -> dict[str, object]:
    """Return a participant's ``transport/link/tls``, with mutual authentication."""
    certificate, key = str(folder / f"{name}.pem"), str(folder / f"{name}.key")
    return {
        "root_ca_certificate": str(folder / f"{authority}.pem"),
        "listen_certificate": certificate,
        "listen_private_key": key,
        "connect_certificate": certificate,
        "connect_private_key": key,
        "enable_mtls": True,
    }


def session_config(folder: Path, name: str) -> dict[str, object]:
    return {"mode": "client", "transport": {"link": {"tls": tls(folder, name)}}}


def test_only_sessions_with_a_certificate_join_over_tls(certificates: Path):
    router = {"transport": {"link": {"protocols": ["tls"], "tls": tls(certificates, "router")}}}
    robot1, robot2 = session_config(certificates, "robot1"), session_config(certificates, "robot2")
    stranger = {**session_config(certificates, "stranger"), "connect": {"timeout_ms": 500}}
    with HubNetwork(protocol="tls", zenoh=robot1, router_zenoh=router) as network:
        with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b", zenoh=robot2)) as b:
            see_each_other(a, b)
            subscriber = Subscriber(b, "/map", LATCHED)
            advertise(a, "/map", LATCHED, "secret")
            subscriber.expect("secret")
            assert [link.dst.split("/")[0] for link in a._session.info.links()] == ["tls"]
        # workers on the router's machine stay peers, with TLS to the router and a direct link on loopback
        settings = [network.settings(node, zenoh={**robot1, "mode": "peer"}) for node in ("c", "d")]
        with Hub.open(settings[0]) as c, Hub.open(settings[1]) as d:
            see_each_other(c, d)
            until(
                lambda: {x.dst.split("/")[0] for x in c._session.info.links()} == {"tls", "tcp"},
                "both kinds of link exist",
            )
        # this certificate is signed by an authority that the router does not trust
        with pytest.raises(HubError, match="cannot join the hub"):
            Hub.open(network.settings("c", zenoh=stranger))
        probed = probe_router(network.endpoint, robot1, seconds=40.0)
        assert probed is not None
        assert probed.daemon == "test"
        assert probe_router(network.endpoint, stranger, seconds=0.5) is None


def allow(name: str, keys: list[str], messages: list[str], *flows: str) -> dict[str, object]:
    """Return an access rule; without ``flows``, it applies to both directions."""
    rule = {"id": name, "permission": "allow", "messages": messages, "key_exprs": keys}
    return {**rule, "flows": list(flows)} if flows else rule


def test_access_control_limits_a_robot_to_its_topics(certificates: Path):
    """robot2 may subscribe to everything on the hub, and join late, but publish only /status."""
    tokens = ["liveliness_token", "liveliness_query", "declare_liveliness_subscriber"]
    every = ["put", "delete", "declare_subscriber", "query", "reply", "declare_queryable", *tokens]
    graph = ["@ros2_lv/**", "@midspan/**", "**/@adv/**"]
    access = {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            allow("all", ["**", *graph], every),
            allow("graph", graph, tokens),
            allow("subscriptions", ["**"], ["declare_subscriber"]),
            allow("hear", ["**"], ["put"], "egress"),
            allow("say", ["*/status/**"], ["put"], "ingress"),
            allow("ask", ["**/@adv/**"], ["query"], "ingress"),
            allow("told", ["**", "**/@adv/**"], ["reply", "declare_queryable"], "egress"),
        ],
        "subjects": [{"id": name, "cert_common_names": [name]} for name in ("robot1", "robot2")],
        "policies": [
            {"rules": ["all"], "subjects": ["robot1"]},
            {"rules": ["graph", "subscriptions", "hear", "say", "ask", "told"], "subjects": ["robot2"]},
        ],
    }
    router = {"transport": {"link": {"tls": tls(certificates, "router")}}, "access_control": access}
    with (
        HubNetwork(protocol="tls", router_zenoh=router) as network,
        Hub.open(network.settings("a", zenoh=session_config(certificates, "robot1"))) as a,
        Hub.open(network.settings("b", zenoh=session_config(certificates, "robot2"))) as b,
    ):
        see_each_other(a, b)
        advertise(a, "/map", LATCHED, "kept")
        Subscriber(b, "/map", LATCHED).expect("kept")
        forbidden = advertise(b, "/map", LATCHED, "forged")
        status, command, back = Subscriber(a, "/status"), Subscriber(a, "/cmd_vel"), Subscriber(b, "/odom")
        odom = advertise(a, "/odom")
        allowed, denied = advertise(b, "/status"), advertise(b, "/cmd_vel")
        matched(odom)
        matched(allowed)
        matched(denied)
        denied.put(b"forbidden")
        allowed.put(b"fine")
        odom.put(b"moved")
        status.expect("fine")
        back.expect("moved")
        denied.put(b"forbidden")
        allowed.put(b"again")
        status.expect("fine", "again")
        assert command.samples == []
        own_subscriber = Subscriber(a, "/map", LATCHED)
        until(lambda: a.graph.zid_of(forbidden.gid), "the forger is seen")
        assert own_subscriber.samples == []


def test_two_machines_join_by_their_routers():
    """The sessions of each machine know only their own router, but data and state reach the other machine."""
    with (
        HubNetwork() as first_network,
        HubNetwork(router_zenoh={"connect": {"endpoints": [first_network.endpoint]}}) as second_network,
        Hub.open(first_network.settings("a")) as a,
        Hub.open(second_network.settings("b")) as b,
    ):
        see_each_other(a, b)
        subscriber, stream = Subscriber(b, "/map", LATCHED), Subscriber(b, "/odom")
        advertise(a, "/map", LATCHED, "state")
        subscriber.expect("state")
        publisher = advertise(a, "/odom")
        matched(publisher)
        publisher.put(b"x")
        stream.expect("x")
        assert stream.samples[0].zid == a.zid
        assert b.neighbors() == set(), "all messages go through the router"
        first_network.stop_router()
        until(lambda: not b.graph.publishers(), "the other machine is gone")
        first_network.start_router()
        see_each_other(a, b)
        Subscriber(b, "/map", LATCHED).expect("state")


def test_two_peers_exchange_latched_messages_without_a_router():
    """Two peers, one of which listens at the address to which the other connects."""
    network = HubNetwork(run=False)
    listens = network.settings("a", router=None, zenoh={"listen": {"endpoints": [network.endpoint]}})
    with Hub.open(listens) as a, Hub.open(network.settings("b")) as b:
        see_each_other(a, b)
        advertise(a, "/map", LATCHED, "x")
        Subscriber(b, "/map", LATCHED).expect("x")
