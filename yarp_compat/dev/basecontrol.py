"""The services of a mobile base on the wire, and their clients.

One drives it (`INavigation2DVelocityActionsMsgs.thrift`), one begins its odometry anew (`IOdometry2DMsgs.thrift`).

Ports (`mobileBaseVelocityControl_nws_yarp`, `odometry2D_nws_yarp` of YARP 4): ``<name>/rpc:i`` and the stream
``<name>/data:i`` of MobileBaseVelocity; ``<name>/rpc`` beside the stream ``<name>/odometry:o``.
"""

# mypy: disable-error-code="empty-body"

from __future__ import annotations

from yarp_compat.dev.client import PATIENCE, ServiceClient
from yarp_compat.dev.returnvalue import CallFailed, ReturnValue
from yarp_compat.dev.service import Service, rpc
from yarp_compat.naming.naming import Naming

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
    """Drives a base, as YARP's ``mobileBaseVelocityControl_nwc_yarp`` does.

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
        """Drive: m/s, m/s, deg/s, for so many seconds."""
        return self.remote.applyVelocityCommandRPC(x_vel, y_vel, theta_vel, timeout)

    def getLastVelocityCommand(self) -> tuple[ReturnValue, float, float, float]:
        """The outcome, and what was commanded last: m/s, m/s, deg/s."""
        return self.remote.getLastVelocityCommandRPC()

    def drive(self, x: float, y: float, turn: float, seconds: float = DEFAULT_TIMEOUT) -> None:
        """Drive: m/s, m/s, deg/s; raises `CallFailed` where the base refuses."""
        outcome = self.applyVelocityCommand(x, y, turn, seconds)
        if not outcome:
            raise CallFailed(outcome.code, "the base refuses the command; its log says why")


class Odometry2DClient(ServiceClient[IOdometry2DMsgs]):
    """Begins an odometry anew; what it says is streamed to ``<name>/odometry:o``.

    Args:
        server: its port, ``/baseControl/rpc`` or ``/cer/odometry/rpc``.
        name: the own port's name; empty lets the name server choose one.
        timeout: seconds to wait for a reply; None: for ever.
        naming: who knows the names; by default the name server of ``yarp.conf``.
    """

    def __init__(
        self, server: str, name: str = "", *, timeout: float | None = PATIENCE, naming: Naming | None = None
    ) -> None:
        super().__init__(IOdometry2DMsgs, server, name, timeout=timeout, naming=naming)

    def resetOdometry(self) -> ReturnValue:
        """Begin at zero from here."""
        return self.remote.reset_odometry_RPC()
