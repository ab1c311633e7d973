"""A client of a laser, like YARP's ``rangefinder2D_nwc_yarp`` (`yarp/dev/IRangefinder2D.h`), with a Python interface.

with Rangefinder2DClient("/robot/laser:o") as laser:
    scan, stamp = laser.read()              # waits for the next scan
    laser.getRawData(distances)             # as in C++: true if it succeeded

Meters and degrees, but `LaserMeasurementData` has radians. The bindings lack this interface; here, a method that fills
two numbers in C++ returns them after its outcome, and one that fills one value returns it or fills a list.
"""

from __future__ import annotations

import math
from collections.abc import MutableSequence
from typing import Any, Self, Unpack

from yarp_compat.dev.client import ClientOptions, StreamingClient
from yarp_compat.dev.rangefinder import (
    DeviceStatus,
    IRangefinder2DMsgs,
    LaserMeasurementData,
    LaserScan2D,
    OlderVocabs,
    VocabReply,
)
from yarp_compat.dev.returnvalue import OK, UNREACHED, ReturnCode, ReturnValue, deliver, fill, results_of
from yarp_compat.overriding import override
from yarp_compat.ports.sockets import closed_on_failure
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.errors import WireError


class _LaserCalls(IRangefinder2DMsgs, OlderVocabs):
    """The methods of all releases; a server has some of them."""


class IRangefinder2D:
    """A laser under YARP's names, from its stream and its RPC port."""

    DEVICE_OK_STANDBY, DEVICE_OK_IN_USE, DEVICE_GENERAL_ERROR, DEVICE_TIMEOUT = DeviceStatus

    def __init__(self, laser: _LaserCalls) -> None:
        self._laser = laser
        self._uses_vocabs = False

    def newest(self) -> tuple[LaserScan2D, float] | None:
        """Return the newest scan and its time stamp in seconds; None before the first."""
        raise NotImplementedError

    def getRawData(self, data: Vector, timestamp: MutableSequence[float] | None = None) -> ReturnValue:
        """Fill in the distances of the newest scan, from its first direction to its last; fails before the first."""
        scan, stamp = self.newest() or (None, 0.0)
        if scan is None:
            return UNREACHED
        fill(data, Vector(scan.scans))
        _store_stamp(stamp, timestamp)
        return OK

    def getLaserMeasurement(
        self, data: MutableSequence[LaserMeasurementData], timestamp: MutableSequence[float] | None = None
    ) -> ReturnValue:
        """Fill in the points of the newest scan; fails before the first scan, or if its last angle is the smaller."""
        scan, stamp = self.newest() or (None, 0.0)
        if scan is None:
            return UNREACHED
        if scan.angle_max < scan.angle_min:
            return ReturnValue(ReturnCode.METHOD_FAILED)
        distances = list(scan.scans)
        step = (scan.angle_max - scan.angle_min) / max(len(distances), 1)
        data[:] = [_point(distance, scan.angle_min + i * step) for i, distance in enumerate(distances)]
        _store_stamp(stamp, timestamp)
        return OK

    def getDeviceStatus(self, status: MutableSequence[int] | None = None) -> Any:
        """Return the status in the newest scan; ``DEVICE_TIMEOUT`` before the first."""
        scan, _ = self.newest() or (LaserScan2D(), 0.0)
        known = scan.status in tuple(DeviceStatus)
        return deliver(OK, DeviceStatus(scan.status) if known else DeviceStatus.DEVICE_GENERAL_ERROR, status)

    def getDistanceRange(self) -> tuple[ReturnValue, float, float]:
        """Return the outcome and the limits of the measured distance."""
        outcome, near, far = self._request("getDistanceRange_RPC", "get_ilas_lsdr", [0.0, 0.0])
        return outcome, near, far

    def getScanLimits(self) -> tuple[ReturnValue, float, float]:
        """Return the outcome and the first and last directions."""
        outcome, first, last = self._request("getScanLimits_RPC", "get_ilas_lsar", [0.0, 0.0])
        return outcome, first, last

    def getHorizontalResolution(self, step: MutableSequence[float] | None = None) -> Any:
        """Return the degrees between two rays; 0 if the laser does not report them."""
        outcome, degrees = self._request("getHorizontalResolution_RPC", "get_ilas_lsas", [0.0])
        return deliver(outcome, degrees, step)

    def getScanRate(self, rate: MutableSequence[float] | None = None) -> Any:
        """Return the scans per second; 0 if the laser does not report them."""
        outcome, hertz = self._request("getScanRate_RPC", "get_ilas_lssr", [0.0])
        return deliver(outcome, hertz, rate)

    def getDeviceInfo(self, device_info: MutableSequence[str] | None = None) -> Any:
        """Return the description of the laser; empty if the laser does not report it."""
        outcome, info = self._request("getDeviceInfo_RPC", "get_ilas_lsnf", [""])
        return deliver(outcome, info, device_info)

    def setDistanceRange(self, min: float, max: float) -> ReturnValue:  # noqa: A002 - YARP's names
        """Set the limits of the measured distance."""
        return self._set("setDistanceRange_RPC", "set_ilas_lsdr", min, max)

    def setScanLimits(self, min: float, max: float) -> ReturnValue:  # noqa: A002 - YARP's names
        """Set the first and last directions."""
        return self._set("setScanLimits_RPC", "set_ilas_lsar", min, max)

    def setHorizontalResolution(self, step: float) -> ReturnValue:
        """Set the degrees between two rays."""
        return self._set("setHorizontalResolution_RPC", "set_ilas_lsas", step)

    def setScanRate(self, rate: float) -> ReturnValue:
        """Set the scans per second."""
        return self._set("setScanRate_RPC", "set_ilas_lssr", rate)

    def _set(self, name: str, older: str, *arguments: float) -> ReturnValue:
        outcome: ReturnValue = self._request(name, older, [], *arguments)[0]
        return outcome

    def _request(self, name: str, older: str, default: list[Any], *arguments: float) -> tuple[Any, ...]:
        """Return a call's outcome and results; a server without today's methods gets the older vocabs."""
        if not self._uses_vocabs:
            outcome, *results = results_of(getattr(self._laser, name), *arguments)
            return (outcome, *(results if outcome else default))
        try:
            reply = getattr(self._laser, older)(*arguments)
        except (OSError, WireError):
            return (UNREACHED, *default)
        if isinstance(reply, VocabReply):
            return (OK, *reply.values)
        return (OK if reply else ReturnValue(ReturnCode.METHOD_FAILED),)


class Rangefinder2DClient(StreamingClient[_LaserCalls, LaserScan2D], IRangefinder2D):
    """A client that receives a laser's scans and calls its RPC port.

    ``server`` is the port that streams scans, ``<server>/rpc:i`` its RPC port; ``name`` is the client's port for scans,
    ``<name>/rpc:o`` its port for calls; ``carrier`` is for the stream. For the other arguments, see `ServiceClient`.
    """

    def __init__(self, server: str, name: str = "", carrier: str = "", **options: Unpack[ClientOptions]) -> None:
        rpc_port = name and f"{name}/rpc:o"
        StreamingClient.__init__(
            self, _LaserCalls, f"{server}/rpc:i", rpc_port, server, LaserScan2D, name, carrier, **options
        )
        IRangefinder2D.__init__(self, self.remote)

    @override
    def open(self) -> Self:
        super().open()
        with closed_on_failure(self):
            if self.version is None:  # before 3.12: servers from 3.10 on have today's methods, older ones vocabs
                self._uses_vocabs = not self.getScanLimits()[0]
        return self

    @override
    def newest(self) -> tuple[LaserScan2D, float] | None:
        """Return the newest scan (skipping other data) and its time stamp in seconds; None before the first."""
        return self.last()


def _point(distance: float, degrees: float) -> LaserMeasurementData:
    point = LaserMeasurementData()
    point.set_polar(distance, math.radians(degrees))
    return point


def _store_stamp(stamp: float, into: MutableSequence[float] | None) -> None:
    if into is not None:
        into[:] = [stamp]
