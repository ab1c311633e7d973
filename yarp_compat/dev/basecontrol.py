"""The services of a mobile base on the wire, and their clients.

One drives it (`INavigation2DVelocityActionsMsgs.thrift`), one begins its odometry anew (`IOdometry2DMsgs.thrift`).

Ports (`mobileBaseVelocityControl_nws_yarp`, `odometry2D_nws_yarp` of YARP 4): ``<name>/rpc:i`` and the stream
``<name>/data:i`` of MobileBaseVelocity; ``<name>/rpc`` beside the stream ``<name>/odometry:o``.
"""

# mypy: disable-error-code="empty-body"

from __future__ import annotations

from typing import Self

from yarp_compat.dev.client import PATIENCE, ServiceClient
from yarp_compat.dev.odometry import OdometryData
from yarp_compat.dev.outcome import UNREACHED, called
from yarp_compat.dev.returnvalue import CallFailed, ReturnValue
from yarp_compat.dev.service import Service, rpc
from yarp_compat.dev.stream import Stream
from yarp_compat.naming.naming import Naming
from yarp_compat.wire.errors import WireError

DEFAULT_TIMEOUT = 0.1
"""Seconds for which a command holds where a caller does not say (`INavigation2DVelocityActions.h`)."""


class INavigation2DVelocityActionsMsgs(Service):
    """What a mobile base's port answers."""

    @rpc
    def applyVelocityCommandRPC(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> ReturnValue:
        """Drive: m/s, m/s, deg/s, for so many seconds."""

    @rpc
    def getLastVelocityCommandRPC(self) -> tuple[ReturnValue, float, float, float]:
        """What was commanded last."""


class IOdometry2DMsgs(Service):
    """What an odometry's port answers."""

    @rpc
    def reset_odometry_RPC(self) -> ReturnValue:
        """Begin at zero from here."""


class MobileBaseVelocityControl(ServiceClient[INavigation2DVelocityActionsMsgs]):
    """Drives a base, as YARP's ``mobileBaseVelocityControl_nwc_yarp`` does (`IMobileBaseVelocityControl`).

    Example::

        with MobileBaseVelocityControl("/baseControl/input/command/rpc:i") as base:
            base.drive(0.2, 0.0, 10.0)

    Args:
        server: its port.
        name: the own port's name; empty lets the name server choose one.
        timeout: seconds to wait for a reply; None: for ever.
        naming: who knows the names; by default the name server of ``yarp.conf``.
    """

    def __init__(
        self, server: str, name: str = "", *, timeout: float | None = PATIENCE, naming: Naming | None = None
    ) -> None:
        super().__init__(INavigation2DVelocityActionsMsgs, server, name, timeout=timeout, naming=naming)

    def applyVelocityCommand(
        self, x_vel: float, y_vel: float, theta_vel: float, timeout: float = DEFAULT_TIMEOUT
    ) -> ReturnValue:
        """Drive: m/s, m/s, deg/s, for so many seconds; false where that failed."""
        return called(self.remote.applyVelocityCommandRPC, x_vel, y_vel, theta_vel, timeout)

    def getLastVelocityCommand(self) -> tuple[ReturnValue, float, float, float]:
        """The outcome, and what was commanded last: m/s, m/s, deg/s."""
        try:
            return self.remote.getLastVelocityCommandRPC()
        except (OSError, WireError):
            return UNREACHED, 0.0, 0.0, 0.0

    def drive(self, x: float, y: float, turn: float, seconds: float = DEFAULT_TIMEOUT) -> None:
        """Drive: m/s, m/s, deg/s.

        Raises:
            CallFailed: the base refuses the command.
            OSError: it is not there, or does not answer.
        """
        outcome = self.remote.applyVelocityCommandRPC(x, y, turn, seconds)
        if not outcome:
            raise CallFailed(outcome.code, "the base refuses the command; its log says why")


class Odometry2DClient(ServiceClient[IOdometry2DMsgs]):
    """Hears an odometry, and begins it anew, as YARP's ``odometry2D_nwc_yarp`` does (`IOdometry2D`).

    Args:
        server: what its ports begin with, ``/baseControl/odometry`` or ``/cer/odometry``.
        name: what the own ports begin with; empty lets the name server choose names.
        timeout: seconds to wait for a reply; None: for ever.
        naming: who knows the names; by default the name server of ``yarp.conf``.
    """

    def __init__(
        self, server: str, name: str = "", *, timeout: float | None = PATIENCE, naming: Naming | None = None
    ) -> None:
        mine = name.rstrip("/")
        super().__init__(IOdometry2DMsgs, f"{server}/rpc", mine and f"{mine}/rpc", timeout=timeout, naming=naming)
        self._stream = Stream(f"{server}/odometry:o", OdometryData, mine and f"{mine}/odometry:i", naming=naming)
        self._last: tuple[OdometryData, float] | None = None

    def open(self) -> Self:
        """Open both ports and connect them.

        Raises:
            NamingError: there is no name server.
            PortError: there is no such server.
        """
        super().open()
        try:
            self._stream.open()
        except BaseException:
            self.close()
            raise
        return self

    def close(self) -> None:
        """Close both ports."""
        self._stream.close()
        super().close()

    def read(self) -> tuple[OdometryData, float] | None:
        """Wait for the next odometry, and its time stamp in seconds; None once this is closed."""
        found = self._stream.read()
        self._last = found or self._last
        return found

    def getOdometry(self) -> tuple[ReturnValue, OdometryData, float]:
        """The outcome, the newest odometry, and its time stamp in seconds; false before any has come."""
        try:
            self._last = self._stream.read_now() or self._last
        except WireError:
            return UNREACHED, OdometryData(), 0.0
        return (UNREACHED, OdometryData(), 0.0) if self._last is None else (ReturnValue(), *self._last)

    def resetOdometry(self) -> ReturnValue:
        """Begin at zero from here; false where that failed."""
        return called(self.remote.reset_odometry_RPC)
