"""The connection to one control board of a YARP robot: reads its states and sends commands, on its own thread."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bridge.boards.commands import CommandSlot, Execution, Halt, JointCommand, JointDrive
from bridge.boards.section import ControlBoardSection
from yarp_compat.dev.controlboard import modes
from yarp_compat.dev.controlboard.client import ControlBoardClient
from yarp_compat.dev.controlboard.streams import JointData
from yarp_compat.ports.naming import Naming
from yarp_compat.wire.errors import WireError

_log = logging.getLogger(__name__)

_RETRY_SECONDS = 2.0  # between two attempts to reach a board
_SILENT_SECONDS = 1.0  # without a state; the link then reconnects
_POLL_SECONDS = 0.1
_WORKED_SECONDS = 60.0  # of a link, after which its trouble is logged again


@dataclass(frozen=True)
class Joints:
    """A board's joints on the hub; ``scales`` convert the board's values from degrees to radians (1 for meters)."""

    names: tuple[str, ...]
    scales: tuple[float, ...]


OnJoints = Callable[[Joints, JointData, float], None]


class BoardLink:
    """The link to one board. Its thread writes the attributes, the connection's thread `states`; others only read.

    Args:
        section: the board's configuration.
        local: prefix of the link's own port names.
        on_joints: called with each state and its time in seconds, on the thread of the board's connection.
    """

    def __init__(self, section: ControlBoardSection, local: str, naming: Naming, on_joints: OnJoints) -> None:
        self._section, self._local, self._naming, self._on_joints = section, local, naming, on_joints
        self.joints: Joints | None = None
        self.remote = section.remote
        self.trouble = "not reached yet"
        self.states = 0
        self._logged = ""
        self._commands, self._drive = CommandSlot(), JointDrive()
        self._last_state = 0.0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"midspan-board {section.remote}", daemon=True)

    @property
    def dropped(self) -> int:
        """Number of commands that were replaced by a newer one, or expired."""
        return self._commands.dropped

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Stop the joints that this link moves, and disconnect."""
        self._stopping.set()
        self._commands.wake()
        if self._thread.is_alive():
            self._thread.join()

    def command(self, velocities: Sequence[float], positions: Sequence[float], names: Sequence[str]) -> str:
        """Move the named joints at ``velocities`` (rad/s or m/s) or, if empty, to ``positions`` (rad or m).

        Return why the command is refused, "" if it is accepted.
        """
        board = self.joints
        if board is None:
            return self.trouble
        values, method, mode = positions, "positionMoveGroupRPC", modes.VOCAB_CM_POSITION
        if len(velocities):
            values, method, mode = velocities, "velocityMoveGroupRPC", modes.VOCAB_CM_VELOCITY
        if len(values) != len(names) or not names:
            return f"a command has {len(names)} names and {len(values)} numbers"
        unknown = next((name for name in names if name not in board.names), None)
        if unknown is not None:
            return f"unknown joint {unknown!r}; the board has {', '.join(board.names)}"
        if not all(map(math.isfinite, values)):
            return "a number is not finite"
        joints = tuple(board.names.index(name) for name in names)
        scaled = tuple(float(value) / board.scales[joint] for joint, value in zip(joints, values, strict=True))
        command = JointCommand(method, mode, joints, scaled, time.monotonic() + self._section.timeout)
        return "" if self._commands.put(command) else "the board is being halted"

    def begin_halt(self) -> str:
        """Discard the pending command, and begin to stop all joints; return why that is impossible, "" if it is not."""
        joints = self.joints
        if joints is None:
            return f"{self._section.remote} cannot be stopped: {self.trouble}"
        self._commands.halt(tuple(range(len(joints.names))))
        return ""

    def await_halt(self, seconds: float) -> str:
        """Wait until the board confirms the halt; return "", or why the joints may still be moving."""
        confirmed = self._commands.await_halt(seconds)
        return "" if confirmed else f"{self._section.remote} did not confirm the stop: it may still be moving"

    def _run(self) -> None:
        while not self._stopping.is_set():
            began = time.monotonic()
            client = ControlBoardClient(self._section.remote, self._local, naming=self._naming, on_state=self._on_state)
            try:
                with client:
                    self._prepare(client)
                    self._follow(client)
            except (OSError, WireError) as error:
                self.trouble = str(error) or type(error).__name__
                if self._is_news(began):
                    _log.info("%s: %s", self._section.remote, self.trouble)
            except Exception as error:  # nothing else would stop the joints, which the next connection does
                self.trouble = f"{type(error).__name__}: {error}"
                if self._is_news(began):
                    _log.exception("%s: the link failed", self._section.remote)
            self.joints = None
            self._stopping.wait(_RETRY_SECONDS)

    def _is_news(self, began: float) -> bool:
        """Return whether to log the trouble: it is a different one, or the link has worked for a while."""
        repeated = self.trouble == self._logged and time.monotonic() - began < _WORKED_SECONDS
        self._logged = self.trouble
        return not repeated

    def _prepare(self, client: ControlBoardClient) -> None:
        names = self._section.joints or tuple(self._name(client, axis) for axis in range(client.axes))
        if len(names) != client.axes:
            raise OSError(f"{self._section.remote} has {client.axes} joints, but the configuration names {len(names)}")
        kinds = [client.call("getJointTypeRPC", axis) for axis in range(client.axes)]
        meters = [bool(kind[0]) and kind[1] == modes.VOCAB_JOINTTYPE_PRISMATIC for kind in kinds]
        self._last_state = time.monotonic()
        self._drive.reconnect(client, client.axes)
        self.joints = Joints(names, tuple(1.0 if flag else math.pi / 180.0 for flag in meters))
        self.trouble = ""

    def _name(self, client: ControlBoardClient, axis: int) -> str:
        outcome, *names = client.call("getAxisNameRPC", axis)
        return str(names[0]) if outcome and names else f"joint_{axis}"

    def _follow(self, client: ControlBoardClient) -> None:
        """Execute commands until the board is silent or the link is stopped."""
        before = time.monotonic()
        while not self._stopping.is_set():
            now = time.monotonic()
            if now - before > _SILENT_SECONDS / 2.0:  # this process did not run, or a call took long: states may wait
                self._last_state = min(self._last_state + now - before, now)
            before = now
            if now - self._last_state > _SILENT_SECONDS:
                raise OSError(f"{self._section.remote} has sent no state for {_SILENT_SECONDS:g} s")
            command = self._commands.pop()
            if command is not None:
                self._execute(client, command)
            if self._drive.moving and time.monotonic() >= self._drive.until:  # even while further commands fail
                self._drive.stop(client)
            left = self._drive.until - time.monotonic()
            self._commands.wait(left if self._drive.moving and 0.0 < left < _POLL_SECONDS else _POLL_SECONDS)
        self._drive.stop(client)

    def _execute(self, client: ControlBoardClient, command: JointCommand | Halt) -> None:
        if isinstance(command, Halt):
            if self._drive.halt(client, command):
                self._commands.confirm_halt()
            return
        result = self._drive.execute(client, command)
        if result is Execution.LATE:
            self._commands.drop()
        else:
            rejected = result is Execution.REJECTED
            self.trouble = f"{self._section.remote} rejects commands" if rejected else ""

    def _on_state(self, data: JointData, seconds: float) -> None:
        self._last_state = time.monotonic()
        joints = self.joints
        if joints is not None and data.axes == len(joints.names):
            self.states += 1
            self._on_joints(joints, data, seconds)
