"""The gateway polls the lifecycle nodes of a planner, which these tests stand in for."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from bridge.config.rules import GET_STATE
from bridge.modules.services import Answer
from navigation import lifecycle as words
from navigation.gateway import lifecycle
from navigation.gateway.lifecycle import LifecycleNodes
from tests.peers.hub.network import HubNetwork
from tests.peers.hub.node import HubNode
from tests.support.wait import until

RESET = "midspan nav reset, then midspan nav startup"


class Polling(HubNode):
    """A module's node with the poller."""

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        self.changes = 0
        host: Any = self
        self.nodes: LifecycleNodes = self.on(lambda: LifecycleNodes(host, ("/a", "/b"), self._changed))
        self.on(lambda: self.loop.every(0.02, self.nodes.refresh))

    def _changed(self) -> None:
        self.changes += 1

    def until(self, states: dict[str, str]) -> None:
        until(lambda: self.nodes.inactive == states, f"the states are {states}", 20)


@pytest.fixture
def network() -> Iterator[HubNetwork]:
    with HubNetwork() as network:
        yield network


@pytest.fixture
def polling(network: HubNetwork, monkeypatch: pytest.MonkeyPatch) -> Iterator[Polling]:
    for name in ("POLL_SECONDS", "ACTIVE_POLL_SECONDS"):
        monkeypatch.setattr(lifecycle, name, 0.05)
    with Polling(network.settings("gateway")) as polling:
        yield polling


def serve(node: HubNode, name: str, answer: Callable[[Any, Answer], None]) -> Any:
    return node.on(lambda: node.node.server(f"{name}/get_state", GET_STATE, answer))


def test_states_are_followed_until_the_node_leaves(network: HubNetwork, polling: Polling) -> None:
    state = {"id": 1, "label": "unconfigured"}
    with HubNode(network.settings("a")) as node:
        serve(node, "/a", lambda _request, answer: answer({"current_state": state}))
        polling.until({"/a": "unconfigured"})
        state["label"] = "inactive"
        polling.until({"/a": "inactive"})
        state["label"] = "active"
        polling.until({})
        until(lambda: polling.changes == 3, "each change is reported", 20)
        state["label"] = "inactive"
        polling.until({"/a": "inactive"})
    polling.until({})


def test_a_silent_node_has_one_pending_request(
    network: HubNetwork, polling: Polling, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers: list[Answer] = []
    awake = threading.Event()

    def on_request(_request: Any, answer: Answer) -> None:
        answers.append(answer)
        if awake.is_set():
            answer({"current_state": {"id": 3, "label": "active"}})

    with HubNode(network.settings("b")) as node:
        serve(node, "/b", on_request)
        until(lambda: answers, "the lifecycle node receives a request", 20)
        polls: list[None] = []
        polling.on(lambda: polling.loop.every(0.02, lambda: polls.append(None)))
        until(lambda: len(polls) > 20, "the poller has run 20 more times", 20)
        assert (len(answers), polling.nodes.inactive) == (1, {})
        monkeypatch.setattr(lifecycle, "ANSWER_SECONDS", 0.2)
        polling.until({"/b": words.SILENT})
        until(lambda: len(answers) > 1, "the lifecycle node receives another request", 20)
        awake.set()
        polling.until({})


def test_a_node_may_appear_while_another_thread_reads_the_states() -> None:
    host: Any = None
    nodes = LifecycleNodes(host, (), lambda: None)
    known: dict[str, Any] = nodes._nodes

    class Node:
        @property
        def state(self) -> str:
            known["/b"] = self
            return "inactive"

    known["/a"] = Node()
    assert nodes.inactive == {"/a": "inactive"}


@pytest.mark.parametrize(
    ("states", "cure"),
    [
        ((), ""),
        (("unconfigured", "unconfigured"), "midspan nav startup"),
        (("inactive",), "midspan nav activate"),
        (("inactive", "unconfigured"), RESET),
        (("finalized", "inactive"), "start these nodes again, then: midspan nav startup"),
        (
            ("activating",),
            "wait for the transition to end; if it does not: midspan nav reset, then midspan nav startup",
        ),
    ],
)
def test_the_cure_depends_on_the_states(states: tuple[str, ...], cure: str) -> None:
    nodes = {f"/n{number}": state for number, state in enumerate(states)}
    assert words.cure(nodes) == cure
    assert bool(words.trouble(nodes)) == bool(states)
    assert all(f"n{number} ({state})" in words.trouble(nodes) for number, state in enumerate(states))
