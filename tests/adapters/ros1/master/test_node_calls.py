"""Calls to nodes are made in order, with the newest values, and independently of nodes that do not respond."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.adapters.ros1.master import node_calls
from bridge.adapters.ros1.master.node_calls import NodeCalls
from bridge.adapters.ros1.master.registrations import Link
from bridge.adapters.ros1_peers import ExhaustedError, XmlRpcClient
from tests.peers.ros1.fake_node import FakeNode
from tests.support.ports import free_port
from tests.support.wait import until


@pytest.fixture
def node() -> Iterator[FakeNode]:
    node = FakeNode()
    yield node
    node.close()


@pytest.fixture
def other() -> Iterator[FakeNode]:
    node = FakeNode()
    yield node
    node.close()


@pytest.fixture
def rejected() -> list[tuple[Link, str]]:
    return []


@pytest.fixture
def calls(rejected: list[tuple[Link, str]], monkeypatch: pytest.MonkeyPatch) -> Iterator[NodeCalls]:
    monkeypatch.setattr(node_calls, "_SECONDS", 20.0)  # a call that times out would be queued again
    monkeypatch.setattr(node_calls, "_RETRY_SECONDS", (0.1,))
    calls = NodeCalls(lambda subscriber, key: rejected.append((subscriber, key)))
    yield calls
    calls.close()


def test_calls_arrive_in_order(calls: NodeCalls, node: FakeNode):
    for number in range(50):
        calls.publisher_update(node.api, f"/t{number}", [node.api] * number)
    calls.param_update(Link("/n", node.api), "/a/", "/a/b/", {"x": 1})
    calls.shut_down(node.api, "/n", "new node")
    until(lambda: len(node.calls) == 52, "all calls have arrived")
    assert node.calls[:50] == [("publisherUpdate", f"/t{n}", [node.api] * n) for n in range(50)]
    assert node.calls[50:] == [("paramUpdate", "/a/b/", {"x": 1}), ("shutdown", "[/n] Reason: new node")]


def test_a_newer_value_replaces_a_waiting_one(calls: NodeCalls, node: FakeNode):
    node.answers.clear()
    subscriber = Link("/n", node.api)
    calls.publisher_update(node.api, "/first", [])
    until(lambda: calls.waiting == 0, "the first call is being made")
    for number in range(100):
        calls.publisher_update(node.api, "/t", [f"http://{number}/"])
        calls.param_update(subscriber, "/p/", "/p/", number)
    calls.param_update(subscriber, "/p/", "/p/x/", 1)
    calls.param_update(subscriber, "/p/", "/p/", 100)
    assert calls.waiting == 3
    node.answers.set()
    until(lambda: ("paramUpdate", "/p/", 100) in node.calls, "the last call has arrived")
    newest = [call for call in node.calls if call[1] != "/first"]
    assert newest == [
        ("publisherUpdate", "/t", ["http://99/"]), ("paramUpdate", "/p/x/", 1), ("paramUpdate", "/p/", 100),
    ]  # fmt: skip


def test_nodes_that_never_answer_do_not_delay_others_and_are_called_again(
    calls: NodeCalls, other: FakeNode, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(node_calls, "_SECONDS", 0.3)
    silent = [FakeNode() for _ in range(20)]
    try:
        for node in silent:
            node.answers.clear()
            calls.publisher_update(node.api, "/t", ["http://1/"])
        started = time.monotonic()
        calls.publisher_update(other.api, "/t", ["http://1/"])
        until(lambda: other.calls, "the other node has been called")
        assert time.monotonic() - started < 30
        for node in silent:
            node.answers.set()
        until(lambda: all(node.calls for node in silent), "the silent nodes have been called again")
        until(lambda: calls.waiting == 0, "no call waits")
    finally:
        for node in silent:
            node.close()


def test_a_node_that_has_ended_is_not_called_again(calls: NodeCalls, other: FakeNode):
    api = f"http://127.0.0.1:{free_port()}/"
    for number in range(10):
        calls.publisher_update(api, f"/t{number}", [])
    until(lambda: calls.waiting == 0, "the calls are dropped")
    for invalid in ("http://", "rosrpc://host:1", "http://host:port/", "http://[::1/"):
        calls.publisher_update(invalid, "/t", [])
    until(lambda: calls.waiting == 0, "calls to invalid addresses are dropped")
    calls.publisher_update(other.api, "/t", [])
    until(lambda: other.calls, "other nodes are called")


def test_a_call_is_repeated_once_this_process_has_file_descriptors_again(
    calls: NodeCalls, node: FakeNode, monkeypatch: pytest.MonkeyPatch
):
    failures = [ExhaustedError("no file descriptor left")] * 2

    def connect(*arguments: Any) -> XmlRpcClient:
        if failures:
            raise failures.pop()
        return XmlRpcClient(*arguments)

    monkeypatch.setattr(node_calls, "XmlRpcClient", connect)
    calls.publisher_update(node.api, "/t", [node.api])
    until(lambda: node.calls == [("publisherUpdate", "/t", [node.api])], "the call has arrived")


def test_the_number_of_waiting_calls_is_limited(calls: NodeCalls, node: FakeNode, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(node_calls, "_MAX_QUEUED", 5)
    node.answers.clear()
    for number in range(100):
        calls.publisher_update(node.api, f"/t{number}", [])
    assert calls.waiting <= 5
    node.answers.set()
    until(lambda: node.calls and node.calls[-1][1] == "/t99", "the newest call has arrived")
    assert [call[1] for call in node.calls[-5:]] == [f"/t{n}" for n in range(95, 100)]


def test_a_subscriber_that_rejects_a_parameter_is_reported(calls: NodeCalls, rejected: list[tuple[Link, str]]):
    node = FakeNode(code=-1)
    subscriber = Link("/n", node.api)
    calls.publisher_update(node.api, "/t", [])
    calls.param_update(subscriber, "/a/", "/a/b/", 1)
    until(lambda: rejected, "the rejection is reported")
    assert rejected == [(subscriber, "/a/")]
    node.close()


def test_the_calls_of_a_dead_node_can_be_dropped(calls: NodeCalls, node: FakeNode):
    node.answers.clear()
    calls.publisher_update(node.api, "/first", [])
    until(lambda: calls.waiting == 0, "the first call is being made")
    calls.publisher_update(node.api, "/second", [])
    calls.drop(node.api)
    assert calls.waiting == 0
