"""The connection to one control board of a YARP robot: reads its states and sends commands, on its own thread.

A command is valid for a limited time, then zero velocity is sent once. A new command replaces the previous one,
without a queue: commands that arrive while the board does not answer are stale by then, and dropped.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
_HALT_SECONDS = 2.0  # time limit of a halt
_HALT = "stopAllRPC"


@dataclass(frozen=True)
class Joints:
    """The joints of a board on the hub; ``scales`` convert its values from YARP's degrees to radians (1 for meters)."""

    names: tuple[str, ...]
    scales: tuple[float, ...]


@dataclass(frozen=True)
class JointCommand:
    """A command for joints, by index: velocities or positions in YARP's units; ``until``: monotonic time."""

    method: str
    mode: int
    joints: tuple[int, ...]
    values: tuple[float, ...]
    until: float


OnJoints = Callable[[Joints, JointData, float], None]


class BoardLink:
    """The link to one board.

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
        self.states = self.dropped = 0
        self._command: JointCommand | None = None
        self._driven: tuple[int, ...] = ()  # the joints whose velocity is not zero, as far as known
        self._until = 0.0
        self._last_state = 0.0
        self._lock = threading.Lock()
        self._halted = threading.Event()
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"midspan-board {section.remote}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Stop the joints that this link moves, and disconnect."""
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()

    def command(self, velocities: Sequence[float], positions: Sequence[float], names: Sequence[str]) -> str:
        """Move the named joints (radians, radians per second); returns why it is invalid, "" if it is valid."""
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
        with self._lock:
            if self._command is not None and self._command.method == _HALT:
                return "the board is being halted"
            if self._command is not None:
                self.dropped += 1  # a newer one takes its place
            self._command = JointCommand(method, mode, joints, scaled, time.monotonic() + self._section.timeout)
        self._wake.set()
        return ""

    def halt(self) -> None:
        """Discard the pending command and stop all joints; raises `TimeoutError` if the board does not confirm it."""
        joints = self.joints
        if joints is None:
            raise TimeoutError(f"{self._section.remote} cannot be stopped: {self.trouble}")
        with self._lock:
            self._halted.clear()
            self._command = JointCommand(_HALT, 0, tuple(range(len(joints.names))), (), math.inf)
        self._wake.set()
        if not self._halted.wait(_HALT_SECONDS):
            raise TimeoutError(f"{self._section.remote} did not confirm the stop: it may still be moving")

    def _run(self) -> None:
        while not self._stopping.is_set():
            client = ControlBoardClient(self._section.remote, self._local, naming=self._naming, on_state=self._on_state)
            try:
                with client:
                    self._prepare(client)
                    self._follow(client)
            except (OSError, WireError) as error:
                if str(error) != self.trouble:
                    _log.info("%s: %s", self._section.remote, error)
                self.trouble = str(error) or type(error).__name__
            self.joints = None
            self._stopping.wait(_RETRY_SECONDS)

    def _prepare(self, client: ControlBoardClient) -> None:
        names = self._section.joints or tuple(self._name(client, axis) for axis in range(client.axes))
        if len(names) != client.axes:
            raise OSError(f"{self._section.remote} has {client.axes} joints, and the configuration names {len(names)}")
        kinds = [client.call("getJointTypeRPC", axis) for axis in range(client.axes)]
        metres = [bool(kind[0]) and kind[1] == modes.VOCAB_JOINTTYPE_PRISMATIC for kind in kinds]
        self._last_state = time.monotonic()
        self._driven = tuple(
            joint for joint in self._driven if joint < client.axes
        )  # driven when the connection was lost
        self._stop_driven(client)
        self.joints = Joints(names, tuple(1.0 if flag else math.pi / 180.0 for flag in metres))
        self.trouble = ""

    def _name(self, client: ControlBoardClient, axis: int) -> str:
        outcome, *names = client.call("getAxisNameRPC", axis)
        return str(names[0]) if outcome and names else f"joint_{axis}"

    def _follow(self, client: ControlBoardClient) -> None:
        """Execute commands until the board is silent or the link is stopped."""
        while not self._stopping.is_set():
            now = time.monotonic()
            if now - self._last_state > _SILENT_SECONDS:
                raise OSError(f"{self._section.remote} has sent no state for {_SILENT_SECONDS:g} s")
            with self._lock:
                command, self._command = self._command, None
            if command is not None:
                self._execute(client, command)
            elif self._driven and now >= self._until:
                self._stop_driven(client)
            left = self._until - time.monotonic()
            if self._wake.wait(left if self._driven and 0.0 < left < _POLL_SECONDS else _POLL_SECONDS):
                self._wake.clear()
        self._stop_driven(client)

    def _execute(self, client: ControlBoardClient, command: JointCommand) -> None:
        if command.method == _HALT:
            self._driven = command.joints
            self._stop_driven(client)
            if client.call(_HALT)[0]:
                self._halted.set()
            return
        if not self._in_mode(client, command) or time.monotonic() > command.until:
            self.dropped += 1
            return
        drives = command.method.startswith("velocity")
        others = tuple(joint for joint in self._driven if joint not in command.joints)
        if drives:  # also if the call fails: part of it may have arrived
            self._driven, self._until = others + command.joints, command.until
        if not client.call(command.method, command.joints, command.values)[0]:
            self.trouble = f"{self._section.remote} rejects commands"
            return
        self.trouble = ""
        if drives and self._stop_joints(client, others):
            self._driven = tuple(j for j, value in zip(command.joints, command.values, strict=True) if value)

    def _in_mode(self, client: ControlBoardClient, command: JointCommand) -> bool:
        """Switch the joints to the command's control mode, and return whether they are in it."""
        mode = client.state("controlMode")
        if mode is not None and all(mode[0][joint] == command.mode for joint in command.joints):
            return True
        wanted = [command.mode] * len(command.joints)
        return bool(client.call("setControlModeGroupRPC", command.joints, wanted)[0])

    def _stop_driven(self, client: ControlBoardClient) -> None:
        """Command zero velocity to the joints that this link moves; until it is confirmed they count as moving."""
        if self._stop_joints(client, self._driven):
            self._driven = ()

    @staticmethod
    def _stop_joints(client: ControlBoardClient, joints: tuple[int, ...]) -> bool:
        return not joints or bool(client.call("velocityMoveGroupRPC", joints, (0.0,) * len(joints))[0])

    def _on_state(self, data: JointData, seconds: float) -> None:
        self._last_state = time.monotonic()
        joints = self.joints
        if joints is not None and data.axes == len(joints.names):
            self.states += 1
            self._on_joints(joints, data, seconds)
