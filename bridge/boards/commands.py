"""Commands for the joints of one control board: the newest command, and the joints that it moves.

A command is valid for a limited time; when a velocity expires, zero is sent once. A new command replaces the previous
one, without a queue: commands that arrive while the board does not answer would be stale once it answers, and are
dropped.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Protocol

_HALT_METHOD = "stopAllRPC"
_LATE_SECONDS = 1.0  # after a reconnection, until the joints that moved are stopped once more


class Board(Protocol):
    """The calls of `yarp_compat.dev.controlboard.client.ControlBoardClient` that commands need."""

    def call(self, method: str, *args: Any) -> Sequence[Any]:
        """Call a method; the first value of the reply is whether the call succeeded."""

    def state(self, name: str) -> tuple[Any, ...] | None:
        """Return the newest values of the board's state stream."""


@dataclass(frozen=True)
class JointCommand:
    """A command for joints, by index: velocities or positions in YARP's units; ``until``: monotonic time."""

    method: str
    mode: int
    joints: tuple[int, ...]
    values: tuple[float, ...]
    until: float


@dataclass(frozen=True)
class Halt:
    """Stop all ``joints`` of a board."""

    joints: tuple[int, ...]


class CommandSlot:
    """The newest command for one board. Safe to use from any thread; ``_lock`` guards the command and ``dropped``."""

    def __init__(self) -> None:
        self.dropped = 0
        self._lock = threading.Lock()
        self._command: JointCommand | Halt | None = None
        self._halted, self._wake = threading.Event(), threading.Event()

    def put(self, command: JointCommand) -> bool:
        """Replace the waiting command; return False if that is a halt."""
        with self._lock:
            if isinstance(self._command, Halt):
                return False
            self.dropped += self._command is not None
            self._command = command
        self._wake.set()
        return True

    def halt(self, joints: tuple[int, ...]) -> None:
        """Replace the waiting command with a halt."""
        with self._lock:
            self._halted.clear()
            self._command = Halt(joints)
        self._wake.set()

    def await_halt(self, seconds: float) -> bool:
        """Wait for the confirmation of the last halt; return whether it arrives in time."""
        return self._halted.wait(seconds)

    def confirm_halt(self) -> None:
        """Confirm that the board has halted."""
        self._halted.set()

    def drop(self) -> None:
        """Count a command that was not executed."""
        with self._lock:
            self.dropped += 1

    def pop(self) -> JointCommand | Halt | None:
        """Remove and return the waiting command."""
        with self._lock:
            command, self._command = self._command, None
        return command

    def wake(self) -> None:
        """End the current `wait`."""
        self._wake.set()

    def wait(self, seconds: float) -> None:
        """Wait for a command, or a call of `wake`."""
        if self._wake.wait(seconds):
            self._wake.clear()


class Execution(Enum):
    """The result of a command."""

    DONE = auto()
    REJECTED = auto()
    LATE = auto()
    """The command expired, or the joints cannot be switched to the command's control mode."""


class JointDrive:
    """Executes commands on a board, and stops the joints that it moves. Used only on the thread of the board's link.

    Attributes:
        moving: the joints whose velocity is not zero, as far as known; until a stop is confirmed they count as moving.
        until: when the command of the moving joints expires (monotonic seconds).
    """

    def __init__(self) -> None:
        self.moving: tuple[int, ...] = ()
        self.until = 0.0

    def reconnect(self, board: Board, axes: int) -> None:
        """Stop the joints that moved when the connection was lost, now and once more when ``until`` has passed.

        The board may be late to execute a command that it received before the loss.
        """
        self.moving = tuple(joint for joint in self.moving if joint < axes)
        if _stop(board, self.moving):
            self.until = time.monotonic() + _LATE_SECONDS

    def execute(self, board: Board, command: JointCommand) -> Execution:
        """Execute a command; the other joints that move are stopped."""
        if not _in_mode(board, command) or time.monotonic() > command.until:
            return Execution.LATE
        drives = command.method.startswith("velocity")
        others = tuple(joint for joint in self.moving if joint not in command.joints)
        if drives:  # even if the call fails, since a part of it may have arrived
            self.moving, self.until = others + command.joints, command.until
        else:  # the change of the control mode has ended the velocities of the command's joints
            self.moving = others
        if not board.call(command.method, command.joints, command.values)[0]:
            return Execution.REJECTED
        if _stop(board, others):
            moves = zip(command.joints, command.values, strict=True) if drives else ()
            self.moving = tuple(joint for joint, value in moves if value)
        return Execution.DONE

    def halt(self, board: Board, halt: Halt) -> bool:
        """Stop all joints; return whether the board confirms it."""
        self.moving = halt.joints
        self.stop(board)
        return bool(board.call(_HALT_METHOD)[0])

    def stop(self, board: Board) -> None:
        """Command zero velocity to the joints that move."""
        if _stop(board, self.moving):
            self.moving = ()


def _in_mode(board: Board, command: JointCommand) -> bool:
    """Switch the joints to the command's control mode, and return whether they are in it."""
    mode = board.state("controlMode")
    if mode is not None and all(mode[0][joint] == command.mode for joint in command.joints):
        return True
    wanted = [command.mode] * len(command.joints)
    return bool(board.call("setControlModeGroupRPC", command.joints, wanted)[0])


def _stop(board: Board, joints: tuple[int, ...]) -> bool:
    return not joints or bool(board.call("velocityMoveGroupRPC", joints, (0.0,) * len(joints))[0])
