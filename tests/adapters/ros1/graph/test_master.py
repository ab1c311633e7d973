"""The thread that follows the master."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.adapters.ros1.graph.master import Master
from bridge.adapters.ros1.graph.state import MasterState
from bridge.adapters.ros1.peer_pool import PeerPool
from bridge.adapters.ros1_peers import UnreachableError
from tests.support.ports import free_port
from tests.support.wait import until


@pytest.mark.parametrize("reachable", [True, False])
def test_a_failure_of_the_edge_ends_the_worker(monkeypatch: pytest.MonkeyPatch, *, reachable: bool) -> None:
    """Otherwise the thread would end silently, and the worker would keep the last state of the graph forever."""

    def seen(_state: MasterState | None) -> None:
        raise RuntimeError("can't start new thread")

    node, ledger, failures = cast("Any", SimpleNamespace(name="/midspan")), cast("Any", None), list[str]()
    uri = f"http://127.0.0.1:{free_port()}/"
    master = Master(
        uri, node, "test", ledger, 0.05, seen, failures.append, lambda _: False, PeerPool(), simulated=False
    )
    if reachable:
        monkeypatch.setattr(master, "_poll", lambda: MasterState("run", "network"))
    master.start()
    until(lambda: failures, "the failure is reported")
    assert failures == ["following the ROS 1 master failed: RuntimeError: can't start new thread"]
    master._thread.join()


def test_a_suspension_during_one_read_does_not_lose_the_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without connections to other nodes, an unknown graph would end all routes."""
    node, ledger = cast("Any", SimpleNamespace(name="/midspan")), cast("Any", None)
    states, known = list[MasterState | None](), MasterState("run", "network")
    master = Master(
        f"http://127.0.0.1:{free_port()}/", node, "test", ledger, 0.05, states.append, lambda _: None, lambda _: False,
        PeerPool(), simulated=False,
    )  # fmt: skip
    reads = itertools.count(1)

    def poll() -> MasterState:
        if next(reads) == 2:
            master._answered_at = float("-inf")  # this process was suspended, so the request's deadline has passed
            raise UnreachableError("the master does not respond in time")
        return known

    monkeypatch.setattr(master, "_poll", poll)
    master.start()
    until(lambda: len(states) > 1, "the master is read again")
    master._stopping.set()
    master.wake()
    master._thread.join()
    assert None not in states
