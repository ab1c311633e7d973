"""Triggers that come one after the other."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

from bridge.config.sections.record import TriggerSection
from bridge.record.triggers import Triggers


def test_a_trigger_that_wrote_nothing_does_not_silence_the_next_one() -> None:
    host: Any = MagicMock()
    asked: list[Future[Path | None]] = []

    def keep(_why: str) -> Future[Path | None]:
        asked.append(Future())
        return asked[-1]

    Triggers(host, TriggerSection(), keep)
    (_, halt), _ = host.answer.call_args
    halt({})
    halt({})
    assert len(asked) == 1, "it is being written"
    asked[0].set_result(None)
    halt({})
    asked[1].set_exception(OSError("the disk is full"))
    halt({})
    asked[2].set_result(Path("ring"))
    halt({})
    assert len(asked) == 3
