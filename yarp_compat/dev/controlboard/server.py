"""A server that offers a board of joints to clients of YARP 3 and 4, and to users of ``yarp rpc``.

The ports are those of `controlBoard_nws_yarp`: ``/rpc:i`` of 3.x and ``/nws/rpc:i`` of 4.0, ``/command:i``,
``/state:o`` (positions) and ``/stateExt:o`` (the complete state).
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
from yarp_compat.dev.controlboard.streams import CommandMessage, JointData, parse_command
from yarp_compat.dev.controlboard.vocab_rpc import respond
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnValue
from yarp_compat.dev.server import ServiceServer
from yarp_compat.naming.client import NameClient
from yarp_compat.overriding import override
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
    "iPwmControl": "setRefDutyCycleOneRPC",  # the misspelled name that the client of 4.0 uses
    "iPositionControl": "positionMoveOneRPC",
    "iPositionDirect": "setRefPositionOneRPC",
    "iPreciselyTimed": "getEncoderOneRPC",
    "iRemoteCalibrator": "",
    "iRemoteVariables": "getRemoteVariableRPC",
    "iTorqueControl": "setRefTorqueOneRPC",
    "iVelocityControl": "velocityMoveOneRPC",
    "iVelocityDirect": "",
}
"""By YARP 4's name of an interface: a method that boards with this interface define; "": no board offers it."""


def _forwarder(name: str) -> Callable[..., Any]:
    def call(self: BoardService, *arguments: Any) -> Any:
        return answer(self.board, name, arguments)

    return call


class BoardService(ControlBoardMsgs):
    """A board's methods for clients of YARP 4."""

    def __init__(self, board: JointBoard) -> None:
        super().__init__()
        self.board = board

    @override
    def getDeviceInterfacesRPC(self) -> tuple[ReturnValue, dict[str, bool]]:
        kind = type(self.board)
        has = {
            name: bool(m) and getattr(kind, m) is not getattr(ControlBoardMsgs, m) for name, m in _INTERFACES.items()
        }
        return OK, has


for _name in ControlBoardMsgs.calls():
    if _name not in vars(BoardService):
        setattr(BoardService, _name, _forwarder(_name))


class BoardHandler:
    """The handler of a board's requests and commands, for ports that another object owns; thread-safe."""

    def __init__(self, board: JointBoard) -> None:
        self.board = board
        self.service = BoardService(board)
        self.refused = 0  # number of invalid or refused commands
        self._numbers = itertools.count()

    def respond(self, request: list[Any]) -> list[Any]:
        """Return the reply to a Bottle of vocabs."""
        return respond(self.board, request, (next(self._numbers), time.time()))

    def execute(self, received: Received) -> None:
        """Execute a command; raises `WireError` if it is invalid, and does nothing if the board refuses it."""
        try:
            method, arguments = parse_command(received.to(CommandMessage))
            answer(self.board, method, arguments)
        except (CallFailed, NotImplementedError) as error:
            self.refused += 1
            log.debug("the board refused a command from %s: %s", received.source, error)
        except WireError:
            self.refused += 1
            raise


class ControlBoardServer(Openable):
    """A board with its own ports, and a thread that streams its state every ``period`` seconds."""

    def __init__(self, name: str, board: JointBoard, *, naming: Naming | None = None, period: float = 0.02) -> None:
        naming = naming or NameClient()
        self._name, self._period = name, period
        self.handler = BoardHandler(board)
        self._state, self._positions = (Writer(f"{name}/{end}", naming=naming) for end in ("stateExt:o", "state:o"))
        newest = Generations(Generation.YARP_4)
        self._ports = (
            ServiceServer(f"{name}/nws/rpc:i", self.handler.service, generations=newest, naming=naming),
            Server(f"{name}/rpc:i", self.handler.respond, naming=naming),
            _CommandPort(f"{name}/command:i", self.handler, naming=naming),
            self._state,
            self._positions,
        )
        self._open = ExitStack()
        self._stop = threading.Event()

    @override
    def open(self) -> Self:
        """Open the ports; raises `NamingError` without a name server."""
        with closed_on_failure(self):
            for port in self._ports:
                self._open.enter_context(port)
            self._stop.clear()
            streamer = threading.Thread(target=self._stream, name=f"board {self._name}", daemon=True)
            streamer.start()
            self._open.callback(streamer.join)
            self._open.callback(self._stop.set)
        return self

    @override
    def close(self) -> None:
        self._open.close()

    def _stream(self) -> None:
        number = 0
        while not self._stop.wait(self._period):
            number += 1
            state = self.handler.board.run(self.handler.board.state)
            envelope = f"{number} {time.time():.9f}"
            self._state.write(state, envelope)
            self._positions.write(positions(state), envelope)


def positions(state: JointData) -> Vector:
    """Return the message of ``/state:o``."""
    angles = state.values.get("jointPosition")
    return Vector(state.axes) if angles is None else Vector(angles)


class _CommandPort(OpenPort):
    def __init__(self, name: str, handler: BoardHandler, *, naming: Naming) -> None:
        self._handler = handler
        super().__init__(name, naming=naming, is_output=False)

    @override
    def _on_message(self, message: PortMessage) -> None:
        received = Received(message, self.core.profile)
        try:
            self._handler.execute(received)
        except WireError as error:
            log.warning("%s: rejected a command from %s: %s", self.name, received.source, error)
