"""The master API: checks of calls, registrations, and the resulting calls to nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from bridge.adapters.ros1.master import api, registrations
from bridge.adapters.ros1.master.api import MasterApi
from bridge.adapters.ros1.master.registrations import Link
from tests.peers.ros1.outbox import RecordedCalls

A, B, C = "http://host:1/", "http://host:2/", "http://host:3/"
STRING = "std_msgs/String"
WRONG = "ERROR: parameter"
NO_TYPE = "is not a valid package resource name"
ROOT = "Error: invalid arguments: cannot set root of parameter tree to non-dictionary"


class ApiUnderTest:
    """An API, and the calls to nodes that it makes."""

    def __init__(self) -> None:
        self.outbox = RecordedCalls()
        self.api = MasterApi("http://master:11311/", self.outbox)

    def call(self, method: str, *params: Any) -> list[Any]:
        return self.api.methods[method](*params)


@pytest.fixture
def master() -> ApiUnderTest:
    return ApiUnderTest()


@pytest.mark.parametrize(
    ("method", "params", "reply"),
    [
        ("getUri", (), [-1, "missing required caller_id parameter", ""]),
        ("getUri", (5,), [-1, "caller_id must be a string", ""]),
        ("getUri", ("/n", 1), [-1, "Error: bad call arity", ""]),
        ("getUri", ("/n",), [1, "", "http://master:11311/"]),
        ("setParam", ("/n", "", 1), [-1, f"{WRONG} [key] must be specified and non-empty", 0]),
        ("setParam", ("/n", 5, 1), [-1, f"{WRONG} [key] must be a string", 0]),
        ("setParam", ("/n", "k", None), [-1, f"{WRONG} [value] must be specified", 0]),
        ("setParam", ("/n", "k" * 3000, 1), [-1, f"{WRONG} [key] is longer than 2048 characters", 0]),
        ("setParam", ("/n", "/", 5), [-1, ROOT, 0]),
        ("searchParam", ("n", "k"), [0, "Internal failure: namespace must be global", 0]),
        ("getParam", ("/n", "k"), [-1, "Parameter [/k] is not set", 0]),
        ("deleteParam", ("/n", "k"), [-1, "parameter [/k] is not set", 0]),
        ("registerPublisher", ("/n", "t", "A", A), [-1, f"{WRONG} [topic_type] {NO_TYPE}", []]),
        ("registerPublisher", ("/n", "/", STRING, A), [-1, f"{WRONG} [topic] cannot be the global namespace", []]),
        ("registerPublisher", ("/n", "a b", STRING, A), [-1, f"{WRONG} [topic] contains illegal chars", []]),
        ("registerPublisher", ("/n", "", STRING, A), [-1, f"{WRONG} [topic] must be a non-empty string", []]),
        ("registerPublisher", ("/n", "t", STRING, "x"), [-1, f"{WRONG} [caller_api] is not an RPC URI", []]),
        ("registerPublisher", ("/n", "t", STRING, 5), [-1, f"{WRONG} [caller_api] is not an XMLRPC URI", []]),
        ("lookupNode", ("/n", "/x"), [-1, "unknown node [/x]", ""]),
        ("lookupService", ("/n", "/x"), [-1, "no provider", ""]),
        ("unregisterPublisher", ("/n", "/t", A), [1, "[/n] is not a registered node", 0]),
        ("shutdown", ("/n", "why"), [0, "this master is a part of Midspan, which starts and stops it", 0]),
    ],
)  # fmt: skip
def test_invalid_parameters_and_unknown_names_have_specific_replies(
    master: ApiUnderTest, method: str, params: tuple[Any, ...], reply: list[Any]
):
    assert master.call(method, *params) == reply


def test_publishers_and_subscribers_learn_of_each_other(master: ApiUnderTest):
    assert master.call("registerSubscriber", "/sub", "t", "*", B)[2] == []
    assert master.call("registerPublisher", "/pub", "t", STRING, A) == [
        1,
        "Registered [/pub] as publisher of [/t]",
        [B],
    ]
    assert master.outbox.pop() == [(B, "publisherUpdate", "/t", [A])]
    assert master.call("registerSubscriber", "/late", "/t", STRING, C)[2] == [A]
    assert master.call("getSystemState", "/n")[2] == [[["/t", ["/pub"]]], [["/t", ["/sub", "/late"]]], []]
    assert master.call("getTopicTypes", "/n")[2] == [["/t", STRING]]
    assert master.call("getPublishedTopics", "/n", "")[2] == [["/t", STRING]]
    assert master.call("getPublishedTopics", "/n", "/other")[2] == []
    assert master.call("lookupNode", "/n", "pub")[2] == A
    assert master.call("unregisterPublisher", "/pub", "/t", B)[2] == 0
    assert master.call("unregisterPublisher", "/pub", "/t", A)[2] == 1
    assert master.outbox.pop() == [(B, "publisherUpdate", "/t", []), (C, "publisherUpdate", "/t", [])]
    assert master.call("lookupNode", "/n", "/pub")[0] == -1


def test_a_new_subscribers_update_is_repeated_with_the_current_publishers(
    master: ApiUnderTest, monkeypatch: pytest.MonkeyPatch
):
    """The update may overtake the reply to the subscriber's registration."""
    monkeypatch.setattr(api, "NEW_SECONDS", 600.0)  # this process may stand still for some seconds
    master.call("registerPublisher", "/early", "t", STRING, A)
    master.call("registerSubscriber", "/sub", "t", "*", B)
    assert master.outbox.delayed == [], "the reply contains all publishers"
    for node, uri in (("/pub", C), ("/pub2", "http://host:4/")):
        master.call("registerPublisher", node, "t", STRING, uri)
    master.call("unregisterPublisher", "/pub", "t", C)
    master.outbox.pop()
    ((seconds, repeat),) = master.outbox.delayed
    assert seconds == api.REPEAT_SECONDS
    repeat()
    assert master.outbox.pop() == [(B, "publisherUpdate", "/t", [A, "http://host:4/"])]
    master.call("registerPublisher", "/pub", "t", STRING, C)
    master.call("unregisterSubscriber", "/sub", "t", B)
    master.outbox.pop()
    master.outbox.delayed[1][1]()
    assert master.outbox.pop() == [], "the subscriber has unsubscribed"

    master.call("registerSubscriber", "/sub", "t", "*", B)
    monkeypatch.setattr(api, "NEW_SECONDS", 0.0)
    master.call("registerPublisher", "/late", "t", STRING, "http://host:5/")
    master.call("registerSubscriber", "/sub2", "other", "*", B)
    assert len(master.outbox.delayed) == 2
    assert list(master.api._new_subscribers) == [("/other", B)], "older subscribers are forgotten"


def test_a_node_that_is_replaced_is_shut_down_and_loses_its_registrations(master: ApiUnderTest):
    master.call("registerSubscriber", "/sub", "/t", "*", C)
    master.call("registerPublisher", "/node", "/t", STRING, A)
    master.call("registerService", "/node", "/srv", "rosrpc://host:9", A)
    master.outbox.pop()
    master.call("registerPublisher", "/node", "/other", STRING, B)
    assert master.outbox.pop() == [
        (A, "shutdown", "/node", "new node registered with same name"), (C, "publisherUpdate", "/t", []),
    ]  # fmt: skip
    assert master.call("lookupService", "/n", "/srv")[0] == -1
    assert master.call("getSystemState", "/n")[2] == [[["/other", ["/node"]]], [["/t", ["/sub"]]], []]
    assert master.call("lookupNode", "/n", "/node")[2] == B
    # when the old node unregisters late, nothing is removed
    assert master.call("unregisterPublisher", "/node", "/other", A)[2] == 0


def test_one_of_two_nodes_with_the_same_name_that_start_together_remains(
    master: ApiUnderTest, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(api, "REPLACED_SECONDS", 600.0)  # this process may stand still for some seconds
    master.call("registerPublisher", "/node", "/rosout", STRING, A)
    master.call("registerPublisher", "/node", "/rosout", STRING, B)
    shutdown = (A, "shutdown", "/node", "new node registered with same name")
    assert master.outbox.pop() == [shutdown]
    replaced = "a new node named [/node] has replaced the node at http://host:1/"
    for method, *params in [
        ("registerService", "/srv", "rosrpc://host:9", A), ("registerSubscriber", "/t", "*", A),
        ("registerPublisher", "/t", STRING, A), ("subscribeParam", A, "/p"),
    ]:  # fmt: skip
        assert master.call(method, "/node", *params)[:2] == [-1, replaced]
    assert master.outbox.pop() == []
    assert master.call("getSystemState", "/n")[2] == [[["/rosout", ["/node"]]], [], []]
    assert master.call("lookupNode", "/n", "/node")[2] == B
    assert master.call("registerService", "/other", "/srv", "rosrpc://host:9", A)[0] == 1, "another name is free"
    master.call("unregisterPublisher", "/node", "/rosout", B)
    assert master.call("registerPublisher", "/node", "/t", STRING, A)[0] == 1, "the name is free again"
    master.outbox.pop()
    master.call("registerPublisher", "/node", "/t", STRING, B)
    monkeypatch.setattr(api, "REPLACED_SECONDS", 0.0)
    assert master.call("registerPublisher", "/node", "/t", STRING, A)[0] == 1, (
        "a later node at the same address may register"
    )
    assert [call[1] for call in master.outbox.pop()] == ["shutdown", "shutdown"]


def test_a_service_has_the_last_server_that_registered(master: ApiUnderTest):
    master.call("registerService", "/one", "/srv", "rosrpc://host:8", A)
    master.call("registerService", "/two", "/srv", "rosrpc://host:9", B)
    assert master.call("lookupService", "/n", "/srv") == [1, "rosrpc URI: [rosrpc://host:9]", "rosrpc://host:9"]
    assert master.call("unregisterService", "/one", "/srv", "rosrpc://host:8")[2] == 0
    assert master.call("getSystemState", "/n")[2][2] == [["/srv", ["/two"]]]
    assert master.call("unregisterService", "/two", "/srv", "rosrpc://host:9")[2] == 1
    assert master.call("getSystemState", "/n")[2][2] == []


def test_any_type_never_replaces_the_type_of_a_topic(master: ApiUnderTest):
    types: Callable[[], list[list[str]]] = lambda: master.call("getTopicTypes", "/n")[2]  # noqa: E731
    master.call("registerSubscriber", "/n", "/t", "*", A)
    assert types() == []
    master.call("registerPublisher", "/n", "/t", "*", A)
    assert types() == [["/t", "*"]]
    master.call("registerSubscriber", "/n", "/t", "std_msgs/Int8", A)
    assert types() == [["/t", "*"]]
    master.call("registerPublisher", "/n", "/t", STRING, A)
    master.call("registerPublisher", "/n", "/t", "*", A)
    assert types() == [["/t", STRING]]


def test_parameters_reach_their_subscribers_but_not_the_node_that_set_them(master: ApiUnderTest):
    assert master.call("subscribeParam", "/a", A, "/ns")[2] == {}
    assert master.call("subscribeParam", "/b", B, "/ns/x")[2] == {}
    master.call("setParam", "/a", "/ns/x", 5)
    assert master.outbox.pop() == [(B, "paramUpdate", "/ns/x/", 5)]
    assert master.call("subscribeParam", "/c", C, "/ns")[2] == {"x": 5}
    master.call("setParam", "/b", "/ns", {"x": 6})
    assert master.outbox.pop() == [
        (A, "paramUpdate", "/ns/", {"x": 6}), (C, "paramUpdate", "/ns/", {"x": 6}), (B, "paramUpdate", "/ns/x/", 6),
    ]  # fmt: skip
    assert master.call("unsubscribeParam", "/a", A, "/ns")[2] == 1
    master.api.drop_param_subscriber(Link("/c", C), "/ns/")
    master.call("deleteParam", "/b", "/ns")
    assert master.outbox.pop() == [(B, "paramUpdate", "/ns/x/", {})]
    assert master.call("lookupNode", "/n", "/c")[0] == -1


def test_a_dead_node_is_removed_unless_it_has_been_replaced(master: ApiUnderTest):
    master.call("registerSubscriber", "/sub", "/t", "*", C)
    master.call("registerPublisher", "/node", "/t", STRING, A)
    master.outbox.pop()
    assert not master.api.remove_dead("/node", B)
    assert master.api.remove_dead("/node", A)
    assert not master.api.remove_dead("/node", A)
    assert master.outbox.pop() == [(C, "publisherUpdate", "/t", [])]
    assert master.call("getSystemState", "/n")[2] == [[], [["/t", ["/sub"]]], []]


def test_the_number_of_registrations_is_limited(master: ApiUnderTest, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(registrations, "MAX_REGISTRATIONS", 3)
    for _ in range(2):
        for topic in ("/a", "/b", "/c"):
            assert master.call("registerPublisher", "/n", topic, STRING, A)[0] == 1
        code, message, value = master.call("registerSubscriber", "/n", "/d", STRING, A)
        assert (code, value) == (-1, [])
        assert "3 registrations" in message
        for topic in ("/a", "/b", "/c"):
            assert master.call("unregisterPublisher", "/n", topic, A)[2] == 1


def test_types_of_topics_without_nodes_are_dropped_beyond_a_limit(
    master: ApiUnderTest, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(registrations, "MAX_TYPES", 5)
    master.call("registerPublisher", "/n", "/used", STRING, A)
    for number in range(20):
        master.call("registerPublisher", "/m", f"/t{number}", STRING, B)
        master.call("unregisterPublisher", "/m", f"/t{number}", B)
    types = dict(master.call("getTopicTypes", "/n")[2])
    assert types["/used"] == STRING
    assert len(types) <= 6


def test_shutdown_ends_a_master_that_allows_it():
    ended: list[bool] = []
    master = MasterApi("", RecordedCalls(), shut_down=lambda: ended.append(True))
    assert master.methods["shutdown"]("/n", "why") == [1, "shutdown", 0]
    assert ended == [True]
