"""Requests and replies between Midspan's own programs."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from bridge.hub.control import WorkerAnswer
from bridge.hub.node import Hub
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until


def test_all_sessions_that_serve_a_verb_respond(network: HubNetwork):
    with (
        Hub.open(network.settings("a", worker="ros1", daemon="robot1")) as a,
        Hub.open(network.settings("b", worker="ros2", daemon="robot1")) as b,
        Hub.open(network.settings("c", worker="ros1", daemon="robot2")) as c,
        Hub.open(network.settings("cli")) as cli,
    ):
        for number, hub in enumerate((a, b, c)):
            hub.serve("twice", lambda params, number=number: {"number": number, "value": 2 * params["value"]})
        until(lambda: len(cli.graph.nodes()) == 4, "all sessions are linked")
        until(lambda: len(cli.ask("twice", {"value": 21})) == 3, "all sessions reply")
        answers = {(x.daemon, x.worker): x for x in cli.ask("twice", {"value": 21}, timeout=40.0)}
        assert answers[("robot1", "ros2")] == WorkerAnswer("robot1", "ros2", {"number": 1, "value": 42})
        assert set(answers) == {("robot1", "ros1"), ("robot1", "ros2"), ("robot2", "ros1")}
        assert [x.value["number"] for x in cli.ask("twice", {"value": 1}, daemon="robot2", timeout=40.0)] == [2]
        assert [x.value["number"] for x in cli.ask("twice", {"value": 1}, worker="ros2", timeout=40.0)] == [1]
        assert cli.ask("twice", {"value": 1}, daemon="nobody", timeout=0.5) == []
        assert cli.ask("unknown", {}, timeout=0.5) == []


def fails(_params: dict[str, Any]) -> object:
    msg = "out of order"
    raise RuntimeError(msg)


@pytest.mark.parametrize(
    ("handler", "error"), [(fails, "out of order"), (lambda params: params["no"], "'no'")], ids=["raises", "key"]
)
def test_errors_are_reported(network: HubNetwork, handler: Any, error: str):
    with Hub.open(network.settings("a")) as a:
        a.serve("verb", handler)
        a.serve("fine", lambda _params: [1])
        assert a.ask("verb", {}, timeout=40.0) == [WorkerAnswer("test", "test", None, error)]
        assert a.ask("fine", {}, timeout=40.0) == [WorkerAnswer("test", "test", [1])]


def test_unserializable_answer_does_not_affect_the_others(network: HubNetwork):
    with Hub.open(network.settings("a")) as a:
        a.serve("verb", lambda _params: {1, 2})
        a.serve("fine", lambda _params: 1)
        assert [x.error != "" for x in a.ask("verb", {}, timeout=40.0)] == [True]
        assert [x.value for x in a.ask("fine", {}, timeout=40.0)] == [1]


@pytest.mark.parametrize("question", [b"\xff", b"[1]", b"{", b"x" * (2 << 20)])
def test_malformed_query_is_rejected(network: HubNetwork, question: bytes):
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b, network.program() as program:
        a.serve("verb", lambda _params: 1)
        key = f"@midspan/{a.domain}/test/test/verb"
        ask = lambda: list(program.get(key, payload=question, timeout=40))  # noqa: E731
        (reply,) = until(ask, "the program's router knows the session")
        assert b"error" in reply.ok.payload.to_bytes()
        (answer,) = until(lambda: b.ask("verb", {}), "the session is reachable")
        assert answer.value == 1


def test_slow_answer_does_not_delay_samples_or_other_verbs(network: HubNetwork):
    with Hub.open(network.settings("a")) as a:
        go = threading.Event()
        a.serve("slow", lambda _params: go.wait(40))
        a.serve("quick", lambda _params: "here")
        slow: list[list[WorkerAnswer]] = []
        asker = threading.Thread(target=lambda: slow.append(a.ask("slow", {}, timeout=40)))
        asker.start()
        assert [x.value for x in a.ask("quick", {}, timeout=40.0)] == ["here"]
        go.set()
        asker.join()
        assert [x.value for x in slow[0]] == [True]


def test_returned_function_ends_the_service(network: HubNetwork):
    with Hub.open(network.settings("a")) as a:
        stop = a.serve("verb", lambda _params: 1)
        assert a.ask("verb", {}, timeout=40.0)
        stop()
        stop()
        assert a.ask("verb", {}, timeout=0.5) == []
