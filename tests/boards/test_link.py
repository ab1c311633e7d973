"""The link to a control board."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from bridge.boards.link import BoardLink
from bridge.boards.section import ControlBoardSection


def follow(monkeypatch: pytest.MonkeyPatch, pauses: list[float]) -> float:
    """Follow a board that sends no state; return the seconds after which the link was stopped.

    ``pauses``: seconds between the rounds.
    """
    link = BoardLink(ControlBoardSection(remote="/robot/arm"), "/here", MagicMock(), MagicMock())
    now, left = [0.0], list(pauses)

    def wait(_seconds: float) -> None:
        if left:
            now[0] += left.pop(0)
        else:
            link._stopping.set()

    monkeypatch.setattr("bridge.boards.link.time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(link._commands, "wait", wait)
    link._follow(MagicMock())
    return now[0]


def test_a_starved_link_does_not_count_the_board_as_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    assert follow(monkeypatch, [0.1, 10.0, 0.1]) > 10.0


def test_a_silent_board_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OSError, match="/robot/arm has sent no state for 1 s"):
        follow(monkeypatch, [0.1, 10.0, *[0.1] * 15])
