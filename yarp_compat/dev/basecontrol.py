"""The services of a mobile base, and their clients.

One service drives the base (`INavigation2DVelocityActionsMsgs.thrift`), the other resets its odometry
(`IOdometry2DMsgs.thrift`).

Ports in YARP 4: `mobileBaseVelocityControl_nws_yarp` has ``<name>/rpc:i`` and receives MobileBaseVelocity at
``<name>/data:i``; `odometry2D_nws_yarp` has ``<name>/rpc`` and streams ``<name>/odometry:o``.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - the names are those of YARP's .thrift file

from __future__ import annotations

from collections.abc import MutableSequence
from dataclasses import dataclass
from typing import Any, Unpack

from yarp_compat.dev.client import ClientOptions, ServiceClient, StreamingClient
from yarp_compat.dev.fields import Generated
from yarp_compat.dev.returnvalue import OK, UNREACHED, CallFailed, ReturnValue, deliver, fetch_three, invoke
from yarp_compat.dev.service import Service, rpc


@dataclass
class OdometryData(Generated):
    """A base's pose in the odometry frame, and its velocity in the base's and the odometry frame: m, deg, s."""

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
    """A commanded velocity: forward and to the left in m/s, counterclockwise in deg/s."""

    vel_x: float = 0.0
    vel_y: float = 0.0
    vel_theta: float = 0.0


DEFAULT_TIMEOUT = 0.1
"""Default validity of a command in seconds (`INavigation2DVelocityActions.h`)."""


@rpc
class INavigation2DVelocityActionsMsgs(Service):
    """The methods of a mobile base's port: m/s, deg/s; ``timeout`` is a command's validity in seconds."""

    def applyVelocityCommandRPC(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> ReturnValue: ...
    def getLastVelocityCommandRPC(self) -> tuple[ReturnValue, float, float, float]: ...


@rpc
class IOdometry2DMsgs(Service):
    """The methods of an odometry port."""

    def reset_odometry_RPC(self) -> ReturnValue: ...


class MobileBaseVelocityControl(ServiceClient[INavigation2DVelocityActionsMsgs]):
    """A client that drives a base, like YARP's ``mobileBaseVelocityControl_nwc_yarp`` (`IMobileBaseVelocityControl`).

    For the arguments, see `ServiceClient`. Example::

        with MobileBaseVelocityControl("/baseControl/input/command/rpc:i") as base:
            base.drive(0.2, 0.0, 10.0)
    """

    def __init__(self, server: str, name: str = "", **options: Unpack[ClientOptions]) -> None:
        super().__init__(INavigation2DVelocityActionsMsgs, server, name, **options)

    def applyVelocityCommand(
        self, x_vel: float, y_vel: float, theta_vel: float, timeout: float = DEFAULT_TIMEOUT
    ) -> ReturnValue:
        """Drive at a velocity (m/s, m/s, deg/s) for ``timeout`` seconds; the outcome is false on failure."""
        return invoke(self.remote.applyVelocityCommandRPC, x_vel, y_vel, theta_vel, timeout)

    def getLastVelocityCommand(self) -> tuple[ReturnValue, float, float, float]:
        """Return the outcome and the last commanded velocity: m/s, m/s, deg/s."""
        return fetch_three(self.remote.getLastVelocityCommandRPC)

    def drive(self, x: float, y: float, turn: float, seconds: float = DEFAULT_TIMEOUT) -> None:
        """Drive at a velocity (m/s, m/s, deg/s) for a time in seconds.

        Raises `CallFailed` if the base refuses, `OSError` if it does not reply.
        """
        outcome = self.remote.applyVelocityCommandRPC(x, y, turn, seconds)
        if not outcome:
            raise CallFailed(outcome.code, "the base refused the command; see its log")


class Odometry2DClient(StreamingClient[IOdometry2DMsgs, OdometryData]):
    """A client that receives and resets odometry, like YARP's ``odometry2D_nwc_yarp`` (`IOdometry2D`).

    ``server`` is the prefix of the server's ports (``/baseControl/odometry``), ``name`` the prefix of the
    client's ports; ``carrier`` is the stream's carrier. For the other arguments, see `ServiceClient`.
    """

    def __init__(self, server: str, name: str = "", carrier: str = "", **options: Unpack[ClientOptions]) -> None:
        prefix = name.rstrip("/")
        rpc_port, stream_port = prefix and f"{prefix}/rpc", prefix and f"{prefix}/odometry:i"
        super().__init__(
            IOdometry2DMsgs,
            f"{server}/rpc",
            rpc_port,
            f"{server}/odometry:o",
            OdometryData,
            stream_port,
            carrier,
            **options,
        )

    def getOdometry(self, odom: OdometryData | None = None, timestamp: MutableSequence[float] | None = None) -> Any:
        """Get the newest odometry and its time stamp in seconds; the outcome is false before the first message.

        Fill in the arguments and return the outcome; without ``odom``, return the outcome, the odometry and the stamp.
        """
        outcome, odometry, stamp = (UNREACHED, OdometryData(), 0.0) if (last := self.last()) is None else (OK, *last)
        if odom is None:
            return outcome, odometry, stamp
        if outcome and timestamp is not None:
            timestamp[:] = [stamp]
        return deliver(outcome, odometry, odom)

    def resetOdometry(self) -> ReturnValue:
        """Reset the odometry to zero; the outcome is false on failure."""
        return invoke(self.remote.reset_odometry_RPC)
