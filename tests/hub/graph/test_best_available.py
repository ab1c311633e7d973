"""QoS policies that rmw_zenoh's tokens leave open (BEST_AVAILABLE), and policies that rmw does not define."""

from __future__ import annotations

import itertools
import logging
from collections import defaultdict
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.hub.graph.best_available import resolve
from bridge.hub.graph.tokens import EndpointKind, EndpointToken, gid_of, parse_token
from bridge.hub.graph.view import HubGraph
from bridge.hub.node import Hub
from bridge.hub.wire.qos import BEST_AVAILABLE_NS, Durability, Qos, Reliability
from tests.peers.hub.endpoints import HASH
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

RELIABLE, BEST_EFFORT = Reliability.RELIABLE, Reliability.BEST_EFFORT
VOLATILE, LATCHED = Durability.VOLATILE, Durability.TRANSIENT_LOCAL
OPEN = Qos(Reliability.BEST_AVAILABLE, Durability.BEST_AVAILABLE, deadline_ns=BEST_AVAILABLE_NS)
TOKEN = "4:4:,10:,854775806:,:5,,854775806"
"""``rmw_qos_profile_best_available`` as rmw_zenoh_cpp 0.2.10 writes it."""

STRING = "std_msgs/msg/String"
PUBLISHER, SUBSCRIPTION = EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION


@pytest.mark.parametrize(
    ("publishers", "expected"),
    [
        ([], Qos(RELIABLE, LATCHED)),
        ([Qos()], Qos(RELIABLE, VOLATILE)),
        ([Qos(RELIABLE, LATCHED)], Qos(RELIABLE, LATCHED)),
        ([Qos(RELIABLE, LATCHED), Qos()], Qos(RELIABLE, VOLATILE)),
        ([Qos(BEST_EFFORT, LATCHED), Qos(RELIABLE, LATCHED)], Qos(BEST_EFFORT, LATCHED)),
        ([Qos(BEST_EFFORT)], Qos(BEST_EFFORT, VOLATILE)),
        ([OPEN], Qos(RELIABLE, LATCHED)),
        ([OPEN, Qos(BEST_EFFORT)], Qos(BEST_EFFORT, VOLATILE)),
        ([Qos(deadline_ns=5), Qos(deadline_ns=9)], Qos(deadline_ns=9)),
        ([Qos(deadline_ns=5), Qos()], Qos()),
    ],
)
def test_a_subscription_requests_the_strongest_policy_that_all_publishers_offer(
    publishers: list[Qos], expected: Qos
) -> None:
    announced = {str(number): (PUBLISHER, qos) for number, qos in enumerate(publishers)}
    assert resolve(STRING, {**announced, "s": (SUBSCRIPTION, OPEN)})["s"] == expected


@pytest.mark.parametrize(
    ("subscriptions", "deadline_ns"),
    [
        ([], None),
        ([Qos(BEST_EFFORT)], None),
        ([OPEN, Qos(RELIABLE, LATCHED)], None),
        ([Qos(deadline_ns=5), Qos(deadline_ns=9), Qos()], 5),
    ],
)
def test_a_publisher_offers_what_every_subscription_accepts(subscriptions: list[Qos], deadline_ns: int | None) -> None:
    announced = {str(number): (SUBSCRIPTION, qos) for number, qos in enumerate(subscriptions)}
    resolved = resolve(STRING, {**announced, "p": (PUBLISHER, OPEN)})
    assert resolved["p"] == Qos(RELIABLE, LATCHED, deadline_ns=deadline_ns)


@pytest.mark.parametrize("type_name", ["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"])
def test_a_publisher_of_velocities_stays_volatile(type_name: str) -> None:
    resolved = resolve(type_name, {"p": (PUBLISHER, OPEN), "s": (SUBSCRIPTION, OPEN)})
    assert resolved == {"p": Qos(RELIABLE, VOLATILE), "s": Qos(RELIABLE, VOLATILE)}


@pytest.mark.parametrize("kind", [EndpointKind.SERVER, EndpointKind.CLIENT])
def test_services_have_the_default_profile(kind: EndpointKind) -> None:
    assert resolve(STRING, {"s": (kind, OPEN)}) == {"s": Qos()}


def test_only_the_open_policies_change() -> None:
    one_open = Qos(Reliability.BEST_AVAILABLE, VOLATILE, depth=3, deadline_ns=7, lifespan_ns=8)
    resolved = resolve(STRING, {"p": (PUBLISHER, Qos(BEST_EFFORT, LATCHED)), "s": (SUBSCRIPTION, one_open)})
    assert resolved["s"] == Qos(BEST_EFFORT, VOLATILE, depth=3, deadline_ns=7, lifespan_ns=8)
    assert resolved["p"] == Qos(BEST_EFFORT, LATCHED)


DEADLINES = st.sampled_from([None, 5, 9, BEST_AVAILABLE_NS])
PROFILES = st.builds(Qos, st.sampled_from(Reliability), st.sampled_from(Durability), deadline_ns=DEADLINES)


@given(st.lists(st.tuples(st.sampled_from(EndpointKind), PROFILES), max_size=6))
def test_all_open_policies_are_resolved_and_closed_ones_stay(endpoints: list[tuple[EndpointKind, Qos]]) -> None:
    announced = {str(number): endpoint for number, endpoint in enumerate(endpoints)}
    resolved = resolve(STRING, announced)
    assert resolved.keys() == announced.keys()
    for key, (_, qos) in announced.items():
        assert not resolved[key].best_available
        if not qos.best_available:
            assert resolved[key] == qos


TEXTS = st.sampled_from([TOKEN, "::,7:,:,:,,", ":1:,1:,:,:,,", "2::,5:,:,:,,", "4::,5:5,0:,:,,", ":4:,5:9,0:,:,,"])
TOKENS = st.tuples(st.sampled_from(["MP", "MS", "SS"]), st.sampled_from("tttu"), st.sampled_from("AAAB"), TEXTS)


class NoSession:
    """A stand-in for a session, its liveliness and its subscribers; no call has an effect."""

    def __getattr__(self, _name: str) -> Any:
        return lambda *_args, **_more: self


@settings(max_examples=500)
@given(st.lists(st.integers(0, 2) | TOKENS, min_size=3, max_size=12))
def test_the_graph_resolves_its_present_tokens(changes: list[int | tuple[str, str, str, str]]) -> None:
    """A number removes one of the present tokens, and a tuple declares a new one."""
    graph = HubGraph(NoSession(), 0, 100)  # type: ignore[arg-type]
    present: list[str] = []
    for number, change in enumerate(changes):
        if not isinstance(change, int):
            letters, topic, type_name, qos = change
            name = f"{topic}/std_msgs::msg::dds_::{type_name}_/{HASH}"
            present.append(f"@ros2_lv/0/z/0/{number}/{letters}/%/%/n/%{name}/{qos}")
            graph._on_sample(SimpleNamespace(key_expr=present[-1], kind=zenoh.SampleKind.PUT))  # type: ignore[arg-type]
        elif present:
            key = present.pop(change % len(present))
            graph._on_sample(SimpleNamespace(key_expr=key, kind=zenoh.SampleKind.DELETE))  # type: ignore[arg-type]
        if not isinstance(change, int) and change[0] == "SS":
            continue  # the graph is not read until the next change
        assert {e.gid: e.qos for e in graph.endpoints()} == _expected(present)
        assert {e.gid: e.qos for e in graph.subscriptions("/t")}.items() <= _expected(present).items()


def _expected(keys: list[str]) -> dict[bytes, Qos]:
    topics: dict[tuple[str, str], dict[str, tuple[EndpointKind, Qos]]] = defaultdict(dict)
    for key in keys:
        token = parse_token(key)
        assert isinstance(token, EndpointToken)
        topics[token.topic, token.type_name][key] = token.kind, token.qos
    return {gid_of(key): qos for announced in topics.values() for key, qos in resolve(STRING, announced).items()}


class RmwNode:
    """A participant that declares tokens as rmw_zenoh does, with any QoS text."""

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._liveliness, self._numbers = session.liveliness(), itertools.count(1)
        self._head = f"@ros2_lv/{domain}/{session.zid()}/0"

    def declare(self, letters: str, topic: str, qos: str, type_name: str = "String") -> zenoh.LivelinessToken:
        """Announce an endpoint: ``MP`` publisher, ``MS`` subscription, ``SS`` server, ``SC`` client."""
        key = f"{self._head}/{next(self._numbers)}/{letters}/%/%/node/%{topic}"
        return self._liveliness.declare_token(f"{key}/std_msgs::msg::dds_::{type_name}_/{HASH}/{qos}")


@pytest.fixture
def graph(network: HubNetwork) -> Iterator[HubGraph]:
    with Hub.open(network.settings("reader")) as hub:
        yield hub.graph


@pytest.fixture
def node(network: HubNetwork) -> Iterator[RmwNode]:
    with network.program() as session:
        yield RmwNode(session, network.domain)


def until_subscription(graph: HubGraph, reliability: Reliability, durability: Durability) -> None:
    expected = Qos(reliability, durability)
    until(lambda: [s.qos for s in graph.subscriptions("/t")] == [expected], f"the subscription resolves to {expected}")


def test_a_subscription_of_rmw_zenoh_follows_the_publishers(graph: HubGraph, node: RmwNode) -> None:
    subscription = node.declare("MS", "t", TOKEN)
    until_subscription(graph, RELIABLE, LATCHED)
    latched = node.declare("MP", "t", ":1:,1:,:,:,,")
    until(lambda: graph.publishers("/t"), "the latched publisher is seen")
    until_subscription(graph, RELIABLE, LATCHED)
    volatile = node.declare("MP", "t", "::,7:,:,:,,")
    until_subscription(graph, RELIABLE, VOLATILE)
    best_effort = node.declare("MP", "t", "2::,7:,:,:,,")
    until_subscription(graph, BEST_EFFORT, VOLATILE)
    best_effort.undeclare()
    until_subscription(graph, RELIABLE, VOLATILE)
    volatile.undeclare()
    until_subscription(graph, RELIABLE, LATCHED)
    latched.undeclare()
    subscription.undeclare()
    until(lambda: not graph.endpoints(), "all endpoints are gone")
    assert graph.refused == 0


def test_publishers_of_another_topic_or_type_do_not_match(graph: HubGraph, node: RmwNode) -> None:
    tokens = [
        node.declare("MP", "other", "2::,7:,:,:,,"),
        node.declare("MP", "t", "2::,7:,:,:,,", "Int32"),
        node.declare("MS", "t", TOKEN),
    ]
    until(lambda: len(graph.endpoints()) == len(tokens), "all endpoints are seen")
    until_subscription(graph, RELIABLE, LATCHED)


@pytest.mark.parametrize(
    ("letters", "expected"),
    [("MP", Qos(RELIABLE, LATCHED)), ("MS", Qos(RELIABLE, LATCHED)), ("SS", Qos()), ("SC", Qos())],
)
def test_each_kind_of_endpoint_is_on_the_graph(graph: HubGraph, node: RmwNode, letters: str, expected: Qos) -> None:
    token = node.declare(letters, "t", TOKEN)
    until(lambda: [e.qos for e in graph.endpoints()] == [expected], f"an endpoint {letters} with {expected}")
    assert graph.refused == 0
    token.undeclare()
    until(lambda: not graph.endpoints(), "the endpoint is gone")


@pytest.mark.parametrize(
    ("qos", "warning"),
    [
        ("7::,10:,:,:,,", "reliability policy 7"),
        ("3::,10:,:,:,,", "reliability policy 3"),
        (":99:,10:,:,:,,", "durability policy 99"),
        ("::4,10:,:,:,,", "history policy 4"),
        ("::,10:,:,:4,,", "liveliness policy 4"),
        ("::,10:,:,:6,,", "liveliness policy 6"),
        ("18446744073709551615::,10:,:,:,,", "reliability policy 18446744073709551615"),
    ],
)
def test_an_unknown_policy_takes_the_default_with_one_warning(
    graph: HubGraph, node: RmwNode, caplog: pytest.LogCaptureFixture, qos: str, warning: str
) -> None:
    with caplog.at_level(logging.WARNING):
        tokens = [node.declare("MP", topic, qos) for topic in ("t", "t", "u")]
        until(lambda: len(graph.publishers()) == len(tokens), "all publishers are seen")
    assert [p.qos for p in graph.publishers()] == [Qos()] * 3
    warnings = [record.getMessage() for record in caplog.records if record.name.startswith("bridge.hub.graph")]
    assert len(warnings) == 1
    assert warning in warnings[0]
    assert "node" in warnings[0]
    assert graph.refused == 0


def test_each_unknown_policy_is_warned_about_once(
    graph: HubGraph, node: RmwNode, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        token = node.declare("MP", "t", "7:8:9,10:,:,:10,,")
        until(lambda: graph.publishers("/t"), "the publisher is seen")
    assert sum(record.name.startswith("bridge.hub.graph") for record in caplog.records) == 4
    assert [p.qos for p in graph.publishers("/t")] == [Qos()]
    token.undeclare()


def test_many_unknown_policies_do_not_flood_the_log(
    graph: HubGraph, node: RmwNode, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        tokens = [node.declare("MP", "t", f"{number}::,10:,:,:,,") for number in range(100, 400)]
        until(lambda: len(graph.publishers("/t")) == len(tokens), "all publishers are seen")
    assert sum(record.name.startswith("bridge.hub.graph") for record in caplog.records) <= 100
