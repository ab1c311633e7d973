"""The services of a mobile base on the wire, and their clients.

One drives it (`INavigation2DVelocityActionsMsgs.thrift`), one begins its odometry anew (`IOdometry2DMsgs.thrift`).

Ports (`mobileBaseVelocityControl_nws_yarp`, `odometry2D_nws_yarp` of YARP 4): ``<name>/rpc:i`` and the stream
``<name>/data:i`` of MobileBaseVelocity; ``<name>/rpc`` beside the stream ``<name>/odometry:o``.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - names and arguments are those of YARP's .thrift file, and say what each does

from __future__ import annotations

from collections.abc import MutableSequence
from dataclasses import dataclass
from typing import Any, Unpack

from yarp_compat.dev.client import ClientOptions, ServiceClient, StreamingClient
from yarp_compat.dev.fields import Generated
from yarp_compat.dev.returnvalue import OK, UNREACHED, CallFailed, ReturnValue, called, given, three
from yarp_compat.dev.service import Service, rpc


@dataclass
class OdometryData(Generated):
    """A base's pose, and its velocity in the base's own frame and in the odometry's: metres, degrees, seconds."""

    odom_x: float = 0.0
    odom_y: float = 0.0
    odom_theta: float = 0.0
    base_vel_x: float = 0.0
    base_vel_y: float = 0.0
    base_vel_theta: float = 0.0
    odom_vel_x: float = 0.0
    odom_vel_y: float = 0.0
    odom_vel_theta: float = 0.0


@dataclass
class MobileBaseVelocity(Generated):
    """A velocity to drive at: forward and to the left, metres per second; counterclockwise, degrees per second."""

    vel_x: float = 0.0
    vel_y: float = 0.0
    vel_theta: float = 0.0


DEFAULT_TIMEOUT = 0.1
"""Seconds for which a command holds where a caller does not say (`INavigation2DVelocityActions.h`)."""


@rpc
class INavigation2DVelocityActionsMsgs(Service):
    """The methods of a mobile base's port: m/s, m/s, deg/s, and seconds for which a command holds."""

    def applyVelocityCommandRPC(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> ReturnValue: ...
    def getLastVelocityCommandRPC(self) -> tuple[ReturnValue, float, float, float]: ...


@rpc
class IOdometry2DMsgs(Service):
    """The methods of an odometry's port, which begins at zero anew."""

    def reset_odometry_RPC(self) -> ReturnValue: ...


class MobileBaseVelocityControl(ServiceClient[INavigation2DVelocityActionsMsgs]):
    """Drives a base, as YARP's ``mobileBaseVelocityControl_nwc_yarp`` does (`IMobileBaseVelocityControl`).

    Arguments as of `ServiceClient`. Example::

        with MobileBaseVelocityControl("/baseControl/input/command/rpc:i") as base:
            base.drive(0.2, 0.0, 10.0)
    """

    def __init__(self, server: str, name: str = "", **options: Unpack[ClientOptions]) -> None:
        super().__init__(INavigation2DVelocityActionsMsgs, server, name, **options)

    def applyVelocityCommand(
        self, x_vel: float, y_vel: float, theta_vel: float, timeout: float = DEFAULT_TIMEOUT
    ) -> ReturnValue:
        """Drive: m/s, m/s, deg/s, for so many seconds; false where that failed."""
        return called(self.remote.applyVelocityCommandRPC, x_vel, y_vel, theta_vel, timeout)

    def getLastVelocityCommand(self) -> tuple[ReturnValue, float, float, float]:
        """The outcome, and what was commanded last: m/s, m/s, deg/s."""
        return three(self.remote.getLastVelocityCommandRPC)

    def drive(self, x: float, y: float, turn: float, seconds: float = DEFAULT_TIMEOUT) -> None:
        """Drive: m/s, m/s, deg/s; raises `CallFailed` where the base refuses, `OSError` where it does not answer."""
        outcome = self.remote.applyVelocityCommandRPC(x, y, turn, seconds)
        if not outcome:
            raise CallFailed(outcome.code, "the base refuses the command; its log says why")


class Odometry2DClient(StreamingClient[IOdometry2DMsgs, OdometryData]):
    """Hears an odometry, and begins it anew, as YARP's ``odometry2D_nwc_yarp`` does (`IOdometry2D`).

    ``server`` begins the names of its ports (``/baseControl/odometry``), ``name`` the own ones; ``carrier`` is the
    stream's; more as of `ServiceClient`.
    """

    def __init__(self, server: str, name: str = "", carrier: str = "", **options: Unpack[ClientOptions]) -> None:
        mine = name.rstrip("/")
        own, said = mine and f"{mine}/rpc", mine and f"{mine}/odometry:i"
        super().__init__(
            IOdometry2DMsgs, f"{server}/rpc", own, f"{server}/odometry:o", OdometryData, said, carrier, **options
        )

    def getOdometry(self, odom: OdometryData | None = None, timestamp: MutableSequence[float] | None = None) -> Any:
        """The newest odometry, and its time stamp in seconds; false before any has come.

        They are filled in where there is something to fill, else returned: the outcome, the odometry, the stamp.
        """
        outcome, found, stamp = (UNREACHED, OdometryData(), 0.0) if (last := self.last()) is None else (OK, *last)
        if odom is None:
            return outcome, found, stamp
        if outcome and timestamp is not None:
            timestamp[:] = [stamp]
        return given(outcome, found, odom)

    def resetOdometry(self) -> ReturnValue:
        """Begin at zero from here; false where that failed."""
        return called(self.remote.reset_odometry_RPC)
