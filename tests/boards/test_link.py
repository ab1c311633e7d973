"""The link to a control board."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from bridge.boards import link as board_link
from bridge.boards.commands import JointCommand
from bridge.boards.link import BoardLink
from bridge.boards.section import ControlBoardSection
from tests.support.wait import until


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


def test_a_link_continues_after_an_unexpected_error(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Its joints may be moving, and commands would be accepted for ever without effect."""
    board, tried, failing = MagicMock(), list[float](), threading.Event()
    failing.set()

    def prepare(link: BoardLink, _client: Any) -> None:
        link.joints, link.trouble = MagicMock(), ""

    def follow(_link: BoardLink, _client: Any) -> None:
        tried.append(time.monotonic())
        if failing.is_set():
            raise IndexError("tuple index out of range")
        _link._stopping.wait(60)

    monkeypatch.setattr(board_link, "_RETRY_SECONDS", 0.01)
    monkeypatch.setattr(board_link, "ControlBoardClient", lambda *_args, **_options: board)
    monkeypatch.setattr(BoardLink, "_prepare", prepare)
    monkeypatch.setattr(BoardLink, "_follow", follow)
    link = BoardLink(ControlBoardSection(remote="/robot/arm"), "/here", MagicMock(), MagicMock())
    link.start()
    try:
        until(lambda: len(tried) > 3, "the link tries again")
        until(lambda: link.trouble == "IndexError: tuple index out of range", "the trouble is reported")
        assert caplog.text.count("/robot/arm: the link failed") == 1, "the same error is logged once"
        failing.clear()
        until(lambda: link.joints is not None, "the link works again")
    finally:
        link.stop()


def test_joints_whose_command_has_expired_stop_although_other_commands_arrive(monkeypatch: pytest.MonkeyPatch) -> None:
    link = BoardLink(ControlBoardSection(remote="/robot/arm"), "/here", MagicMock(), MagicMock())
    board, rounds, stopped = MagicMock(), iter(range(3)), list[bool]()

    def call(method: str, *_args: Any) -> list[bool]:
        if method == "velocityMoveGroupRPC":
            stopped.append(not link._stopping.is_set())
        return [method == "velocityMoveGroupRPC"]  # the joints cannot be switched to another control mode

    def pop() -> JointCommand:
        if next(rounds, None) is None:
            link._stopping.set()
        return JointCommand("velocityMoveGroupRPC", 1, (1,), (5.0,), time.monotonic() + 60.0)

    board.state.return_value, board.call.side_effect = None, call
    link._drive.moving = (0,)
    link._last_state = time.monotonic()
    monkeypatch.setattr(link._commands, "pop", pop)
    monkeypatch.setattr(link._commands, "wait", lambda _seconds: None)
    link._follow(board)
    assert stopped == [True]
