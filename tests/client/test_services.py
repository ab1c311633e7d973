"""Clients of services."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest.mock import MagicMock

import pytest

from bridge.client import services
from bridge.client.errors import ClientError


def test_the_wait_for_a_server_ends_although_the_graph_keeps_changing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services, "_MOST_SECONDS", 0.1)
    graph: Any = MagicMock()

    def watch(changed: Callable[[], None]) -> Callable[[], None]:
        graph.servers.side_effect = lambda _name: changed() or []
        return lambda: None

    graph.watch = watch
    with pytest.raises(ClientError, match="/gone has no server on the hub"):
        services.served(graph, "/gone")
