"""Clients on every side with planners on every side. The table of results is printed at the end of the run."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.navigation import mix_table


@pytest.mark.timeout(300)  # 55 to 95 s on an idle machine, with a fault of each kind
def test_every_client_drives_with_every_planner(
    deployment: Deployment, record_property: Callable[[str, object], None]
) -> None:
    cells: list[mix_table.Cell] = []
    try:
        cells.extend(mix_table.table(deployment))
    except BaseException:
        print(mix_table.text(cells))  # the cells before the failure
        raise
    table = mix_table.text(cells)
    record_property("table", table)
    assert all(cell.good for cell in cells), table
    parts = [cell for cell in cells if cell.part in mix_table.PARTS]
    assert len({(cell.planner, cell.client, cell.part) for cell in parts}) == 3 * 4 * 6
    faults = [(cell.part, cell.client) for cell in cells if cell.part in mix_table.FAULTS]
    assert faults == [(part, client) for part, clients in mix_table.ONE_EACH.items() for client in clients]
    assert len(cells) == len(parts) + len(faults) + 6
