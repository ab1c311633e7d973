"""The thread that follows the master."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.adapters.ros1.graph.master import Master
from bridge.adapters.ros1.graph.state import MasterState
from bridge.adapters.ros1.peer_pool import PeerPool
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
