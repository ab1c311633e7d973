"""A client of a control board of YARP 3 or 4: calls, the stream of commands, and the joints' state.

    with ControlBoardClient("/robot/head", "/my_script") as board:
        board.call("positionMoveOneRPC", 0, 20.0)     # (outcome,)
        board.state("jointPosition")                  # numbers and their time, or None

The board's ports show its release: 4.0 has ``/nws/rpc:i``, 3.x only ``/rpc:i``. Methods have the names of 4.0; scripts
use those of `yarp_compat.dev.controlboard.views`.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any, Self

from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.controlboard import vocab_rpc
from yarp_compat.dev.controlboard.messages import ControlBoardMsgs
from yarp_compat.dev.controlboard.streams import JointData, Numbers, command, is_streamed
from yarp_compat.dev.returnvalue import OK, UNREACHED, ReturnCode, ReturnValue
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.os.data.stamp import Stamp
from yarp_compat.overriding import override
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import Naming, PortError
from yarp_compat.ports.port import PortCore
from yarp_compat.ports.sockets import Openable, closed_on_failure
from yarp_compat.pythonic import Client, OpenPort, Received, payload_of
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

log = logging.getLogger("yarp.dev.ControlBoard")

REPLY_TIMEOUT = 10.0  # seconds
STATE_TIMEOUT = 0.5  # seconds for which the joints' state is valid, as in YARP's option ``timeout``
_NOT_IMPLEMENTED = ReturnValue(ReturnCode.NOT_IMPLEMENTED)
_FAILED = ReturnValue(ReturnCode.METHOD_FAILED)


class ControlBoardClient(Openable):
    """A client of one board; `open` connects, and raises `PortError` if the board is missing.

    Args:
        remote: the prefix of the board's ports.
        local: the prefix of the client's ports.
        carrier: the carrier of the streams.
        timeout: seconds for which the joints' state is valid.
        strict: no command replaces one that is still queued, not even a command to several joints.
        on_state: called with each state and its time in seconds, on the thread of the board's connection.
    """

    def __init__(
        self, remote: str, local: str, *, naming: Naming | None = None, carrier: str = "fast_tcp",
        timeout: float = STATE_TIMEOUT, strict: bool = False,
        on_state: Callable[[JointData, float], None] | None = None,
    ) -> None:  # fmt: skip
        self.remote, self.local = remote, local
        self.profile = Profile.YARP3
        self.axes = 0
        self.strict = strict
        self._naming = naming or NameClient()
        self._carrier = carrier
        self._state = JointState(timeout)
        self._on_state = on_state
        self._open = ExitStack()

    @override
    def open(self) -> Self:
        with closed_on_failure(self):
            self._connect()
        return self

    @override
    def close(self) -> None:
        self._open.close()

    def call(self, method: str, *arguments: Any) -> tuple[Any, ...]:
        """Call a method of `ControlBoardMsgs` and return its outcome and results; a streamed command is ok once sent.

        Raises `TypeError` and `ValueError` for arguments that are not numbers.
        """
        try:
            if is_streamed(method):
                message = command(method, arguments, self.profile)
                strict = self.strict or "One" in method  # commands to two joints in a row must both arrive
                return (OK,) if self._commands.write(payload_of(message), strict=strict) else (UNREACHED,)
            return self._request(method, arguments)
        except WireError as error:
            log.error("%s of %s: %s", method, self.remote, error)
            return (_FAILED,)
        except OSError as error:
            log.error("%s: no reply to %s: %s", self.remote, method, error)
            return (UNREACHED,)

    def state(self, name: str) -> tuple[Numbers, float] | None:
        """Return the last numbers of all joints and their time; None if they are too old or not reported."""
        return self._state.read(name)

    def stamp(self) -> Stamp:
        """Return the number and time of the newest state; invalid before the first state."""
        return self._state.stamp()

    def _request(self, method: str, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
        if self.profile is Profile.YARP4:
            returned = getattr(self._service.remote, method)(*arguments)
            return returned if isinstance(returned, tuple) else (returned,)
        if vocab_rpc.form_of(method) is None:
            return (_NOT_IMPLEMENTED,)
        reply = self._vocab_port.ask(vocab_rpc.request(method, arguments), timeout=REPLY_TIMEOUT)
        return vocab_rpc.results(method, reply)

    def _connect(self) -> None:
        naming = self._naming
        if naming.query(f"{self.remote}/nws/rpc:i") is not None:
            self.profile = Profile.YARP4
            self._service = self._open.enter_context(
                ServiceClient(
                    ControlBoardMsgs, f"{self.remote}/nws/rpc:i", f"{self.local}/nwc/rpc:o",
                    naming=naming, timeout=REPLY_TIMEOUT,
                )
            )  # fmt: skip
        elif naming.query(f"{self.remote}/rpc:i") is not None:
            self.profile = Profile.YARP3
            client = Client(f"{self.remote}/rpc:i", f"{self.local}/rpc:o", naming=naming)
            self._vocab_port = self._open.enter_context(client)
            self._check_protocol()
        else:
            raise PortError(
                f"no control board {self.remote}: neither {self.remote}/nws/rpc:i (YARP 4)"
                f" nor {self.remote}/rpc:i (YARP 3) is registered at the name server"
            )
        writer = PortCore(f"{self.local}/command:o", naming=naming, is_input=False, profile=self.profile)
        self._open.callback(writer.close)
        writer.open()
        done, reply = writer.add_output(f"{self._carrier}:/{self.remote}/command:i")
        if not done:
            raise PortError(reply)
        self._commands = writer
        reader = self._open.enter_context(_StateReader(f"{self.local}/stateExt:i", self._state, naming, self._on_state))
        connections.connect(naming, f"{self.remote}/stateExt:o", reader.name, self._carrier)
        outcome, *axes = self.call("getAxesRPC")
        if not outcome or axes[0] < 1:
            raise PortError(f"{self.remote} does not report its number of joints")
        self.axes = axes[0]

    def _check_protocol(self) -> None:
        answer = self._vocab_port.ask([Vocab("get"), Vocab("prot")], timeout=REPLY_TIMEOUT)
        if answer[:3] != ["prot", *vocab_rpc.PROTOCOL[:2]]:
            log.warning("%s: unexpected protocol version, YARP's is %s: %s", self.remote, vocab_rpc.PROTOCOL, answer)


class JointState:
    """The newest state of a board's joints; thread-safe."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._lock = threading.Lock()
        self._received: tuple[Received, float] | None = None
        self._data: JointData | None = None
        self._stamp = Stamp()
        self._until = 0.0

    def store(self, received: Received) -> None:
        """Store a received state; `read` decodes it."""
        with self._lock:
            self._received = received, time.monotonic()

    def read(self, name: str) -> tuple[Numbers, float] | None:
        """Return a quantity of all joints and the state's time in seconds; None if it is missing or too old."""
        with self._lock:
            received, self._received = self._received, None
            if received is not None:
                self._read(*received)
            if self._data is None or time.monotonic() > self._until:
                return None
            numbers = self._data.values.get(name)
            return None if numbers is None else (numbers, self._stamp.getTime())

    def newest(self) -> tuple[JointData, float] | None:
        """Return the newest state and its time in seconds; None before the first state."""
        self.read("")
        with self._lock:
            return None if self._data is None else (self._data, self._stamp.getTime())

    def stamp(self) -> Stamp:
        """Return the number and time of the newest state."""
        self.read("")
        with self._lock:
            return self._stamp

    def _read(self, received: Received, arrived: float) -> None:
        stamp = Stamp()
        try:
            self._data = received.to(JointData)
        except WireError as error:  # the previous state remains, and expires
            log.warning("rejected a state from %s: %s", received.source, error)
            return
        with suppress(WireError):
            stamp.from_text(received.envelope or "")
        if not stamp.isValid():
            stamp.update(time.time())
        self._stamp, self._until = stamp, arrived + self._timeout


class _StateReader(OpenPort):
    def __init__(
        self, name: str, state: JointState, naming: Naming, on_state: Callable[[JointData, float], None] | None
    ) -> None:
        self._state, self._on_state = state, on_state
        self._reported: JointData | None = None
        super().__init__(name, naming=naming, is_output=False)

    @override
    def _on_message(self, message: PortMessage) -> None:
        self._state.store(Received(message, self.core.profile))
        if self._on_state is not None:
            newest = self._state.newest()
            if newest is not None and newest[0] is not self._reported:  # else the message was rejected
                self._reported = newest[0]
                self._on_state(*newest)
