"""A client of a laser, as YARP's ``rangefinder2D_nwc_yarp`` (`yarp/dev/IRangefinder2D.h`), and the Python way.

with Rangefinder2DClient("/robot/laser:o") as laser:
    scan, stamp = laser.read()              # waits for the next one
    laser.getRawData(distances)             # as in C++: true where it succeeded

Metres and degrees, but `LaserMeasurementData` has radians. The bindings have no such interface; here a method that C++
has fill two numbers returns them behind its outcome, and one that fills one value returns it, or fills a list.
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
    OldAnswer,
    OlderWords,
)
from yarp_compat.dev.returnvalue import OK, UNREACHED, ReturnCode, ReturnValue, answered, fill, given
from yarp_compat.ports.sockets import closed_on_failure
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.errors import WireError


class _LaserCalls(IRangefinder2DMsgs, OlderWords):
    """What servers of any release answer, some of it."""


class IRangefinder2D:
    """A laser under YARP's names, by what it streams and what its port answers."""

    DEVICE_OK_STANDBY, DEVICE_OK_IN_USE, DEVICE_GENERAL_ERROR, DEVICE_TIMEOUT = DeviceStatus

    def __init__(self, laser: _LaserCalls) -> None:
        self._laser = laser
        self._answers_older_words = False

    def newest(self) -> tuple[LaserScan2D, float] | None:
        """The last scan, and its time stamp in seconds; None before any has come."""
        raise NotImplementedError

    def getRawData(self, data: Vector, timestamp: MutableSequence[float] | None = None) -> ReturnValue:
        """The distances of the last scan, from its first to its last direction; false before any has come."""
        scan, stamp = self.newest() or (None, 0.0)
        if scan is None:
            return UNREACHED
        fill(data, Vector(scan.scans))
        _stamped(stamp, timestamp)
        return OK

    def getLaserMeasurement(
        self, data: MutableSequence[LaserMeasurementData], timestamp: MutableSequence[float] | None = None
    ) -> ReturnValue:
        """The points of the last scan; false before any has come."""
        scan, stamp = self.newest() or (None, 0.0)
        if scan is None:
            return UNREACHED
        if scan.angle_max < scan.angle_min:
            return ReturnValue(ReturnCode.METHOD_FAILED)
        distances = list(scan.scans)
        step = (scan.angle_max - scan.angle_min) / max(len(distances), 1)
        data[:] = [_point(distance, scan.angle_min + i * step) for i, distance in enumerate(distances)]
        _stamped(stamp, timestamp)
        return OK

    def getDeviceStatus(self, status: MutableSequence[int] | None = None) -> Any:
        """What the laser last said of itself; ``DEVICE_TIMEOUT`` before it has."""
        scan, _ = self.newest() or (LaserScan2D(), 0.0)
        known = scan.status in tuple(DeviceStatus)
        return given(OK, DeviceStatus(scan.status) if known else DeviceStatus.DEVICE_GENERAL_ERROR, status)

    def getDistanceRange(self) -> tuple[ReturnValue, float, float]:
        """The outcome, and the smallest and the greatest distance that it measures."""
        outcome, near, far = self._asked("getDistanceRange_RPC", "get_ilas_lsdr", [0.0, 0.0])
        return outcome, near, far

    def getScanLimits(self) -> tuple[ReturnValue, float, float]:
        """The outcome, and the first and the last direction."""
        outcome, first, last = self._asked("getScanLimits_RPC", "get_ilas_lsar", [0.0, 0.0])
        return outcome, first, last

    def getHorizontalResolution(self, step: MutableSequence[float] | None = None) -> Any:
        """Degrees between two rays; 0 where the laser does not say."""
        outcome, found = self._asked("getHorizontalResolution_RPC", "get_ilas_lsas", [0.0])
        return given(outcome, found, step)

    def getScanRate(self, rate: MutableSequence[float] | None = None) -> Any:
        """Turns per second; 0 where the laser does not say."""
        outcome, found = self._asked("getScanRate_RPC", "get_ilas_lssr", [0.0])
        return given(outcome, found, rate)

    def getDeviceInfo(self, device_info: MutableSequence[str] | None = None) -> Any:
        """What kind of laser it is; empty where it does not say."""
        outcome, info = self._asked("getDeviceInfo_RPC", "get_ilas_lsnf", [""])
        return given(outcome, info, device_info)

    def setDistanceRange(self, min: float, max: float) -> ReturnValue:  # noqa: A002 - YARP's names
        """Measure from here to there."""
        return self._told("setDistanceRange_RPC", "set_ilas_lsdr", min, max)

    def setScanLimits(self, min: float, max: float) -> ReturnValue:  # noqa: A002 - YARP's names
        """Measure in these directions."""
        return self._told("setScanLimits_RPC", "set_ilas_lsar", min, max)

    def setHorizontalResolution(self, step: float) -> ReturnValue:
        """Measure so many degrees apart."""
        return self._told("setHorizontalResolution_RPC", "set_ilas_lsas", step)

    def setScanRate(self, rate: float) -> ReturnValue:
        """Turn so many times a second."""
        return self._told("setScanRate_RPC", "set_ilas_lssr", rate)

    def _told(self, name: str, older: str, *arguments: float) -> ReturnValue:
        outcome: ReturnValue = self._asked(name, older, [], *arguments)[0]
        return outcome

    def _asked(self, name: str, older: str, default: list[Any], *arguments: float) -> tuple[Any, ...]:
        """A call's outcome and results; a server that knows none of today's methods is asked in the older words."""
        if not self._answers_older_words:
            outcome, *found = answered(getattr(self._laser, name), *arguments)
            return (outcome, *(found if outcome else default))
        try:
            answer = getattr(self._laser, older)(*arguments)
        except (OSError, WireError):
            return (UNREACHED, *default)
        if isinstance(answer, OldAnswer):
            return (OK, *answer.values)
        return (OK if answer else ReturnValue(ReturnCode.METHOD_FAILED),)


class Rangefinder2DClient(StreamingClient[_LaserCalls, LaserScan2D], IRangefinder2D):
    """Hears a laser, and asks its settings.

    ``server`` is the port that streams scans, ``<server>/rpc:i`` the one that answers; ``name`` is the own port, and
    ``<name>/rpc:o`` the one that asks; ``carrier`` is the stream's; more as of `ServiceClient`.
    """

    def __init__(self, server: str, name: str = "", carrier: str = "", **options: Unpack[ClientOptions]) -> None:
        own = name and f"{name}/rpc:o"
        StreamingClient.__init__(
            self, _LaserCalls, f"{server}/rpc:i", own, server, LaserScan2D, name, carrier, **options
        )
        IRangefinder2D.__init__(self, self.remote)

    def open(self) -> Self:
        """Open both ports and connect them; errors as of `ServiceClient.open`."""
        super().open()
        with closed_on_failure(self):
            if self.version is None:  # before 3.12: from 3.10 on it knows today's methods, before that older words
                self._answers_older_words = not self.getScanLimits()[0]
        return self

    def newest(self) -> tuple[LaserScan2D, float] | None:
        """The last scan, and its time stamp in seconds; None before any has come. Other data is left out."""
        return self.last()


def _point(distance: float, degrees: float) -> LaserMeasurementData:
    made = LaserMeasurementData()
    made.set_polar(distance, math.radians(degrees))
    return made


def _stamped(stamp: float, into: MutableSequence[float] | None) -> None:
    if into is not None:
        into[:] = [stamp]
