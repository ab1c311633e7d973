"""The newest command for a board, and the joints that it moves."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from bridge.boards.commands import CommandSlot, Execution, Halt, JointCommand, JointDrive

VELOCITY = "velocityMoveGroupRPC"


def command(*joints: int, value: float = 1.0, method: str = VELOCITY, seconds: float = 10.0) -> JointCommand:
    return JointCommand(method, 7, joints, (value,) * len(joints), time.monotonic() + seconds)


def test_newer_command_replaces_the_waiting_one() -> None:
    slot = CommandSlot()
    first, second = command(0), command(1)
    assert [slot.put(first), slot.put(second)] == [True, True]
    assert (slot.dropped, slot.pop(), slot.pop()) == (1, second, None)
    slot.drop()
    assert slot.dropped == 2


def test_halt_replaces_a_command_and_is_not_replaced() -> None:
    slot, confirmed = CommandSlot(), list[bool]()
    slot.put(command(0))
    slot.halt((0, 1))
    halting = threading.Thread(target=lambda: confirmed.append(slot.await_halt(40.0)))
    halting.start()
    assert not slot.put(command(2)), "the halt waits"
    assert slot.pop() == Halt((0, 1))
    assert slot.put(command(2)), "the halt is being executed"
    slot.confirm_halt()
    halting.join()
    assert confirmed == [True]
    slot.halt((0,))
    assert not slot.await_halt(0.01), "an earlier confirmation does not count"


@pytest.mark.parametrize("wake", [lambda slot: slot.put(command(0)), CommandSlot.wake], ids=["command", "wake"])
def test_waiting_thread_wakes(wake: Callable[[CommandSlot], object]) -> None:
    slot, woken = CommandSlot(), threading.Event()
    waiting = threading.Thread(target=lambda: (slot.wait(40.0), woken.set()))
    waiting.start()
    wake(slot)
    assert woken.wait(20.0)
    waiting.join()


class FakeBoard:
    """Records the calls; those named in ``fails`` are refused."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.fails = set[str]()
        self.modes = [7, 7, 7]

    def call(self, method: str, *args: Any) -> tuple[bool]:
        self.calls.append((method, *args))
        return (method not in self.fails,)

    def state(self, name: str) -> tuple[Any, ...] | None:
        assert name == "controlMode"
        return (self.modes,)


@pytest.fixture
def board() -> FakeBoard:
    return FakeBoard()


def test_command_stops_the_other_joints_that_move(board: FakeBoard) -> None:
    drive = JointDrive()
    assert drive.execute(board, command(0, 1)) is Execution.DONE
    assert drive.moving == (0, 1)
    assert drive.execute(board, command(1, 2)) is Execution.DONE
    assert board.calls == [
        (VELOCITY, (0, 1), (1.0, 1.0)), (VELOCITY, (1, 2), (1.0, 1.0)), (VELOCITY, (0,), (0.0,))
    ]  # fmt: skip
    assert drive.moving == (1, 2)
    drive.stop(board)
    drive.stop(board)
    assert board.calls[3:] == [(VELOCITY, (1, 2), (0.0, 0.0))]
    assert drive.moving == ()


def test_positions_end_the_velocities_of_all_joints(board: FakeBoard) -> None:
    position = "positionMoveGroupRPC"
    drive = JointDrive()
    drive.execute(board, command(0, 1))
    assert drive.execute(board, command(1, 2, method=position)) is Execution.DONE
    assert board.calls[1:] == [(position, (1, 2), (1.0, 1.0)), (VELOCITY, (0,), (0.0,))]
    assert drive.moving == (), "a later zero velocity would be for a joint that moves to a position"
    drive.execute(board, command(0, 1))
    board.fails.add(position)
    assert drive.execute(board, command(1, method=position)) is Execution.REJECTED
    assert drive.moving == (0,)


def test_zero_velocity_and_positions_do_not_count_as_moving(board: FakeBoard) -> None:
    drive = JointDrive()
    drive.execute(board, command(0, value=0.0))
    drive.execute(board, command(1, method="positionMoveGroupRPC"))
    assert drive.moving == ()


def test_late_command_does_not_move_the_joints(board: FakeBoard) -> None:
    drive = JointDrive()
    assert drive.execute(board, command(0, seconds=-1.0)) is Execution.LATE
    board.modes = [7, 3, 7]
    board.fails.add("setControlModeGroupRPC")
    assert drive.execute(board, command(0, 1)) is Execution.LATE
    assert [call[0] for call in board.calls] == ["setControlModeGroupRPC"]
    assert drive.moving == ()


def test_joints_count_as_moving_until_a_stop_is_confirmed(board: FakeBoard) -> None:
    drive = JointDrive()
    board.fails.add(VELOCITY)
    assert drive.execute(board, command(0, 2)) is Execution.REJECTED
    assert drive.moving == (0, 2), "part of the command may have arrived"
    drive.stop(board)
    assert drive.moving == (0, 2)
    board.fails.clear()
    begun = time.monotonic()
    drive.reconnect(board, 2)
    assert (board.calls[-1], drive.moving) == ((VELOCITY, (0,), (0.0,)), (0,)), (
        "the board may execute an earlier command late, so the joint is stopped"
    )
    assert begun < drive.until <= time.monotonic() + 1.0
    drive.stop(board)
    assert (board.calls[-1], drive.moving) == ((VELOCITY, (0,), (0.0,)), ())


def test_stop_that_a_reconnected_board_rejects_is_repeated_at_once(board: FakeBoard) -> None:
    drive = JointDrive()
    drive.execute(board, command(0))
    until = drive.until
    board.fails.add(VELOCITY)
    drive.reconnect(board, 3)
    assert (drive.moving, drive.until) == ((0,), until)


@pytest.mark.parametrize("fails", [set(), {"stopAllRPC"}, {VELOCITY}])
def test_halt_stops_all_joints_and_reports_the_confirmation(board: FakeBoard, fails: set[str]) -> None:
    drive = JointDrive()
    board.fails = fails
    assert drive.halt(board, Halt((0, 1, 2))) is ("stopAllRPC" not in fails)
    assert board.calls == [(VELOCITY, (0, 1, 2), (0.0,) * 3), ("stopAllRPC",)]
    assert drive.moving == ((0, 1, 2) if VELOCITY in fails else ())
