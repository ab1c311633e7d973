"""The worker of a side restarts when the machine gets the missing address of one of its listeners."""

from __future__ import annotations

import pytest

from bridge.adapters.worker import BridgeWorker
from bridge.hub import listeners
from bridge.worker import WorkerFailedError


def test_a_side_restarts_for_an_address_that_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    worker = BridgeWorker("ros1")
    monkeypatch.setattr(listeners, "_absent", {"tcp/203.0.113.7:7447": "203.0.113.7"})
    assert worker.health().text == "starting"
    monkeypatch.setattr(listeners, "has_address", lambda _address: True)
    with pytest.raises(WorkerFailedError, match=r"has got the address of tcp/203\.0\.113\.7:7447"):
        worker.health()
