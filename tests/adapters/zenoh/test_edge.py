"""The thread of a dialect's edge opens the session."""

from __future__ import annotations

import threading

import pytest

from bridge.adapters.zenoh import edge
from bridge.adapters.zenoh.json_keys import JsonKeysEdge


def test_session_is_opened_again_after_an_unexpected_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(edge, "RETRY_SECONDS", 0.01)
    attempts: list[int] = []

    def open_again(of: JsonKeysEdge) -> bool:
        attempts.append(len(attempts))
        if len(attempts) == 1:
            msg = "can't start new thread"
            raise RuntimeError(msg)
        of._stopping.set()
        return False

    monkeypatch.setattr(JsonKeysEdge, "_open_again", open_again)
    keys = JsonKeysEdge.__new__(JsonKeysEdge)
    keys._context, keys._stopping = None, threading.Event()
    keys._tick_on()
    assert len(attempts) == 2
