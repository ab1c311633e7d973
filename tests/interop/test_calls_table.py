"""Services and actions between every pair of sides in both directions; the table is printed at the end of the run."""

from __future__ import annotations

from collections.abc import Callable

from tests.peers.daemon import calls_table
from tests.peers.daemon.deployment import Deployment


def test_services_and_actions_cross_between_each_pair_of_sides(
    deployment: Deployment, record_property: Callable[[str, object], None]
) -> None:
    lines = list(calls_table.table(deployment))
    record_property("table", calls_table.text(lines))
    failed = [line for line in lines if not line.good]
    assert not failed, calls_table.text(failed)
    sides = {"service": 7, "action": 4}
    assert {(n.kind, n.server, n.client) for n in lines} == {(n.kind, n.server, n.client) for n in lines if n.passed}
    assert {k: sum(n.kind == k for n in lines) for k in sides} == {k: n * (n - 1) for k, n in sides.items()}
