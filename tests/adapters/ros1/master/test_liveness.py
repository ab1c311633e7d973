"""Dead nodes are removed."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros1.master import liveness
from bridge.adapters.ros1.master.liveness import Liveness
from bridge.adapters.ros1_peers import ask
from tests.peers.ros1.fake_node import FakeNode
from tests.support.ports import free_port
from tests.support.wait import until


class Checked:
    """Nodes under supervision."""

    def __init__(self, seconds: float) -> None:
        self.nodes: dict[str, str] = {}
        self.alive: list[str] = []
        self.dead: list[str] = []
        self.rounds = threading.Semaphore(0)
        self.liveness = self.create(seconds)

    def create(self, seconds: float) -> Liveness:
        return Liveness(self._listed, self._on_alive, self._on_dead, seconds)

    def _on_alive(self, node: str, _api: str) -> None:
        if node not in self.alive:
            self.alive.append(node)

    def _listed(self) -> dict[str, str]:
        self.rounds.release()
        return dict(self.nodes)

    def _on_dead(self, node: str, api: str) -> None:
        assert self.nodes.pop(node) == api
        self.dead.append(node)

    def wait_for_rounds(self, count: int) -> None:
        for _ in range(count):
            assert self.rounds.acquire(timeout=60)


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch) -> Iterator[Checked]:
    monkeypatch.setattr(liveness, "_PERIODS", (0.02, 0.02))
    monkeypatch.setattr(liveness, "_TIMEOUT", 0.2)
    monkeypatch.setattr(liveness, "_CHECKS_PER_SECOND", 1000.0)
    checked = Checked(0.3)
    yield checked
    checked.liveness.close()


def test_a_node_that_refuses_connections_is_removed_and_others_stay(checked: Checked):
    alive, silent, dying = FakeNode(), FakeNode(), FakeNode()
    checked.nodes = {"/alive": alive.api, "/silent": silent.api, "/dead": dying.api}
    checked.liveness.start({})
    until(lambda: len(checked.alive) == 3, "all nodes have responded")
    silent.answers.clear()
    dying.close()
    until(lambda: checked.dead, "the dead node is removed")
    checked.wait_for_rounds(20)
    assert checked.dead == ["/dead"]
    alive.close()
    until(lambda: len(checked.dead) == 2, "a node that exits is removed")
    assert checked.dead == ["/dead", "/alive"]
    silent.close()


def test_a_node_that_registers_again_is_reported_again(checked: Checked):
    """The master has a new entry for the node, even if no check has noticed its absence in between."""
    node = FakeNode()
    checked.nodes = {"/node": node.api}
    checked.liveness.start({})
    until(lambda: checked.alive, "the node has responded")
    checked.alive.clear()
    until(lambda: checked.alive, "the node is reported again")
    node.close()


def test_a_check_that_fails_is_repeated(checked: Checked, monkeypatch: pytest.MonkeyPatch):
    errors = [ValueError("unexpected")]

    def fail_once(*params: Any) -> Any:
        if errors:
            raise errors.pop()
        return ask(*params)

    monkeypatch.setattr(liveness, "ask", fail_once)
    node = FakeNode()
    checked.nodes = {"/node": node.api}
    checked.liveness.start({})
    until(lambda: checked.alive, "the node has responded")
    node.close()


def test_an_unreachable_node_is_removed_later(checked: Checked, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(liveness, "UNREACHABLE_SECONDS", 0.6)
    silent = FakeNode()
    checked.nodes = {"/silent": silent.api}
    checked.liveness.start({})
    until(lambda: checked.alive, "the node has responded")
    silent.answers.clear()
    until(lambda: checked.dead == ["/silent"], "the node that does not respond is removed")
    silent.close()


def test_a_node_that_answers_again_stays(checked: Checked, monkeypatch: pytest.MonkeyPatch):
    ahead = [0.0]
    monkeypatch.setattr(liveness, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + sum(ahead)))
    node = FakeNode()
    checked.nodes = {"/node": node.api}

    def failures() -> int:
        failed = checked.liveness._failures.get(("/node", node.api))
        return 0 if failed is None else failed.count

    checked.liveness.start({})
    until(lambda: checked.alive, "the node has responded")
    for _ in range(3):
        node.answers.clear()
        until(lambda: failures() >= 3, "several checks have failed")
        ahead.append(0.6 * liveness.UNREACHABLE_SECONDS)
        before = failures()
        until(lambda before=before: failures() > before + 1, "the node is still silent")  # type: ignore[misc]
        node.answers.set()
        until(lambda: not failures(), "the node responds")
    assert checked.dead == []
    node.close()


@pytest.mark.parametrize("host", ["127.0.0.1", "robot.invalid"])
def test_a_node_that_this_machine_never_reached_stays(
    checked: Checked, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, host: str
):
    monkeypatch.setattr(liveness, "UNREACHABLE_SECONDS", 0.3)
    checked.nodes = {"/of_another_machine": f"http://{host}:{free_port()}/"}
    checked.liveness.start({})
    until(lambda: "set ROS_IP or ROS_HOSTNAME there" in caplog.text, "the unreachable node is reported")
    checked.wait_for_rounds(40)
    assert checked.dead == []
    assert caplog.text.count("/of_another_machine") == 1


def test_a_new_node_is_checked_before_the_next_round(checked: Checked, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(liveness, "_PERIODS", (3600.0, 3600.0))
    monkeypatch.setattr(liveness, "_HASTY_PERIOD", 0.02)
    monkeypatch.setattr(liveness, "_TIMEOUT", 20.0)  # a check that fails would be repeated only in an hour
    checked.liveness = checked.create(3600.0)
    checked.liveness.start({})
    checked.wait_for_rounds(3)
    node = FakeNode()
    checked.nodes = {"/new": node.api}
    until(lambda: checked.alive == ["/new"], "the new node is checked")
    checked.wait_for_rounds(5)
    assert node.calls == [("getPid",)], "later the node is checked only with the others"
    node.close()


def test_restored_nodes_are_removed_sooner(checked: Checked, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(liveness, "RESTORED_SECONDS", 0.1)
    checked.liveness.close()
    checked.liveness = checked.create(3600.0)
    node = FakeNode()
    checked.nodes = {"/restored": f"http://127.0.0.1:{free_port()}/", "/new": node.api}
    checked.liveness.start({"/restored": checked.nodes["/restored"]})
    until(lambda: checked.alive, "the new node has responded")
    node.close()
    until(lambda: checked.dead, "the restored node is removed")
    checked.wait_for_rounds(5)
    assert checked.dead == ["/restored"]


def test_a_purge_time_of_zero_removes_no_node():
    checked = Checked(0.0)
    checked.nodes = {"/dead": f"http://127.0.0.1:{free_port()}/"}
    checked.liveness.start({})
    assert checked.liveness._thread.ident is None, "it has not started"
    checked.liveness.close()
