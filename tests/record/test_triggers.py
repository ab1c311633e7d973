"""Consecutive triggers."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

from bridge.record.section import TriggerSection
from bridge.record.triggers import Triggers


def test_a_trigger_that_saved_nothing_does_not_block_the_next_trigger() -> None:
    host: Any = MagicMock()
    requests: list[Future[Path | None]] = []

    def keep(_why: str) -> Future[Path | None]:
        requests.append(Future())
        return requests[-1]

    Triggers(host, TriggerSection(), keep)
    (_, halt), _ = host.answer.call_args
    halt({})
    halt({})
    assert len(requests) == 1, "the ring is being kept"
    requests[0].set_result(None)
    halt({})
    requests[1].set_exception(OSError("the disk is full"))
    halt({})
    requests[2].set_result(Path("ring"))
    halt({})
    assert len(requests) == 3
