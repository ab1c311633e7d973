"""Serves a board of joints to clients of YARP 3 and 4, and to people at ``yarp rpc``.

The ports are those of `controlBoard_nws_yarp`: ``/rpc:i`` of 3.x and ``/nws/rpc:i`` of 4.0, ``/command:i``,
``/state:o`` (positions) and ``/stateExt:o`` (all that is known of the joints).
"""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Self

from yarp_compat.dev.controlboard.board import JointBoard, answer
from yarp_compat.dev.controlboard.messages import ControlBoardMsgs
from yarp_compat.dev.controlboard.streams import CommandMessage, JointData, called
from yarp_compat.dev.controlboard.words import respond
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnValue
from yarp_compat.dev.server import ServiceServer
from yarp_compat.naming.client import NameClient
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import Naming
from yarp_compat.ports.sockets import Openable, closed_on_failure
from yarp_compat.pythonic import OpenPort, Received, Server, Writer
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import Generation, Generations

log = logging.getLogger(__name__)

_INTERFACES = {
    "iAmplifierControl": "enableAmpRPC",
    "iAxisInfo": "getAxisNameRPC",
    "iControlCalibration": "",
    "iControlLimits": "getPosLimitsRPC",
    "iControlMode": "setControlModeOneRPC",
    "iCurrentControl": "getCurrentOneRPC",
    "iEncodersTimed": "getEncoderOneRPC",
    "iImpedanceControl": "",
    "iInteractionMode": "getInteractionModeOneRPC",
    "iJointBrake": "",
    "iJointFault": "getLastJointFaultRPC",
    "iMotor": "getNumberOfMotorsRPC",
    "iMotorEncoders": "getMotorEncoderOneRPC",
    "iPWMControl": "setRefDutyCycleOneRPC",
    "iPidControl": "",
    "iPwmControl": "setRefDutyCycleOneRPC",  # what the client of 4.0 looks for by mistake
    "iPositionControl": "positionMoveOneRPC",
    "iPositionDirect": "setRefPositionOneRPC",
    "iPreciselyTimed": "getEncoderOneRPC",
    "iRemoteCalibrator": "",
    "iRemoteVariables": "getRemoteVariableRPC",
    "iTorqueControl": "setRefTorqueOneRPC",
    "iVelocityControl": "velocityMoveOneRPC",
    "iVelocityDirect": "",
}
"""YARP 4's names of interfaces, and the method that a board of this interface defines; empty: none can."""


def _calling(name: str) -> Callable[..., Any]:
    def call(self: BoardService, *arguments: Any) -> Any:
        return answer(self.board, name, arguments)

    return call


class BoardService(ControlBoardMsgs):
    """A board as YARP 4 calls it."""

    def __init__(self, board: JointBoard) -> None:
        super().__init__()
        self.board = board

    def getDeviceInterfacesRPC(self) -> tuple[ReturnValue, dict[str, bool]]:
        """The interfaces whose methods the board defines."""
        kind = type(self.board)
        has = {
            name: bool(m) and getattr(kind, m) is not getattr(ControlBoardMsgs, m) for name, m in _INTERFACES.items()
        }
        return OK, has


for _name in ControlBoardMsgs.calls():
    if _name not in vars(BoardService):
        setattr(BoardService, _name, _calling(_name))


class BoardAnswers:
    """What a board's ports do with what comes; the ports themselves are whose they are. Any thread."""

    def __init__(self, board: JointBoard) -> None:
        self.board = board
        self.service = BoardService(board)
        self.refused = 0  # commands that were none
        self._numbers = itertools.count()

    def respond(self, asked: list[Any]) -> list[Any]:
        """The answer to a Bottle of vocabs."""
        return respond(self.board, asked, (next(self._numbers), time.time()))

    def take(self, received: Received) -> None:
        """A command came; raises `WireError` where it makes no sense, and does nothing where the board refuses it."""
        try:
            method, arguments = called(received.to(CommandMessage))
            answer(self.board, method, arguments)
        except (CallFailed, NotImplementedError) as error:
            self.refused += 1
            log.debug("a command of %s is refused: %s", received.source, error)
        except WireError:
            self.refused += 1
            raise


class ControlBoardServer(Openable):
    """A board with ports of its own, and a thread that says its state every ``period`` seconds."""

    def __init__(self, name: str, board: JointBoard, *, naming: Naming | None = None, period: float = 0.02) -> None:
        naming = naming or NameClient()
        self._name, self._period = name, period
        self.answers = BoardAnswers(board)
        self._state, self._positions = (Writer(f"{name}/{end}", naming=naming) for end in ("stateExt:o", "state:o"))
        newest = Generations(Generation.YARP_4)
        self._ports = (
            ServiceServer(f"{name}/nws/rpc:i", self.answers.service, generations=newest, naming=naming),
            Server(f"{name}/rpc:i", self.answers.respond, naming=naming),
            _CommandPort(f"{name}/command:i", self.answers, naming=naming),
            self._state,
            self._positions,
        )
        self._open = ExitStack()
        self._stop = threading.Event()

    def open(self) -> Self:
        """Open the ports; raises `NamingError` without a name server."""
        with closed_on_failure(self):
            for port in self._ports:
                self._open.enter_context(port)
            self._stop.clear()
            teller = threading.Thread(target=self._tell, name=f"board {self._name}", daemon=True)
            teller.start()
            self._open.callback(teller.join)
            self._open.callback(self._stop.set)
        return self

    def close(self) -> None:
        """Close them."""
        self._open.close()

    def _tell(self) -> None:
        number = 0
        while not self._stop.wait(self._period):
            number += 1
            state = self.answers.board.run(self.answers.board.state)
            envelope = f"{number} {time.time():.9f}"
            self._state.write(state, envelope)
            self._positions.write(positions(state), envelope)


def positions(state: JointData) -> Vector:
    """What ``/state:o`` says."""
    found = state.values.get("jointPosition")
    return Vector(state.axes) if found is None else Vector(found)


class _CommandPort(OpenPort):
    def __init__(self, name: str, answers: BoardAnswers, *, naming: Naming) -> None:
        self._answers = answers
        super().__init__(name, naming=naming, is_output=False)

    def _take(self, message: PortMessage) -> None:
        received = Received(message, self.core.profile)
        try:
            self._answers.take(received)
        except WireError as error:
            log.warning("%s: a command of %s is refused: %s", self.name, received.source, error)
