"""Laser scans (`yarp/sig/LaserScan2D.h`), and the service of a laser's port (`IRangefinder2DMsgs.thrift`).

Ports (`rangefinder2D_nws_yarp` of YARP 3.6 to 4.0): the stream of LaserScan2D, and the port ``<name>/rpc:i``. Clients
before 3.10 use vocabs: the reply to ``[get] [ilas] [lsdr]`` is ``[is] [lsdr] 0.1 20.0`` (`IRangefinder2D.h`).
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - the names are those of YARP's .thrift file

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Annotated, Any, Concatenate, ParamSpec

from yarp_compat.dev.fields import Choice, Generated
from yarp_compat.dev.returnvalue import CallFailed, ReturnValue
from yarp_compat.dev.service import Service, before, rpc
from yarp_compat.overriding import override
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.portable import Portable

P = ParamSpec("P")


@dataclass
class LaserScan2D(Generated):
    """A scan of a laser: degrees, meters (infinite: no hit), a `DeviceStatus`."""

    angle_min: float = 0.0
    angle_max: float = 0.0
    range_min: float = 0.0
    range_max: float = 0.0
    scans: Vector = field(default_factory=Vector)
    status: int = 3


class LaserMeasurementData:
    """A point of a scan in Cartesian and polar coordinates: meters, radians."""

    def __init__(self) -> None:
        self._x = self._y = self._rho = self._theta = 0.0

    def set_cartesian(self, x: float, y: float) -> None:
        """Set the point by x and y."""
        self._x, self._y, self._rho, self._theta = x, y, math.hypot(x, y), math.atan2(y, x)

    def set_polar(self, rho: float, theta: float) -> None:
        """Set the point by distance and angle."""
        self._rho, self._theta, self._x, self._y = rho, theta, rho * math.cos(theta), rho * math.sin(theta)

    def get_cartesian(self) -> tuple[float, float]:
        """Return x and y, in meters."""
        return self._x, self._y

    def get_polar(self) -> tuple[float, float]:
        """Return distance (meters) and angle (radians)."""
        return self._rho, self._theta


class DeviceStatus(IntEnum):
    """The state of a laser."""

    DEVICE_OK_STANDBY = 0
    DEVICE_OK_IN_USE = 1
    DEVICE_GENERAL_ERROR = 2
    DEVICE_TIMEOUT = 3


_TEXTS = ("lsnf", "btnf")  # the queries whose reply is a text


class VocabReply(Portable):
    """A reply in vocabs: ``[is]``, the vocab of the queried quantity, and its values (numbers or a text)."""

    def __init__(self, quantity: str = "", *values: float | str) -> None:
        self.quantity, self.values = quantity, values

    @override
    def _write(self, out: ElementWriter) -> None:
        out.begin(2 + len(self.values))
        out.vocab("is")
        out.vocab(self.quantity)
        for value in self.values:
            if isinstance(value, str):
                out.string(value)
            else:
                out.float64(value)

    @override
    def _read(self, source: ElementReader) -> None:
        count = source.begin()
        source.word()
        self.quantity = source.word()
        is_text = self.quantity in _TEXTS
        self.values = (source.string(),) if is_text else tuple(source.float64() for _ in range(count - 2))
        source.end()


@rpc
class IRangefinder2DMsgs(Service):
    """The methods of a laser's port: meters, degrees, and scans per second."""

    def getDeviceStatus_RPC(self) -> tuple[ReturnValue, Annotated[DeviceStatus, Choice(DeviceStatus, vocab=True)]]: ...
    def getDistanceRange_RPC(self) -> tuple[ReturnValue, float, float]: ...
    def setDistanceRange_RPC(self, min: float, max: float) -> ReturnValue: ...  # noqa: A002 - YARP's names
    def getScanLimits_RPC(self) -> tuple[ReturnValue, float, float]: ...
    def setScanLimits_RPC(self, min: float, max: float) -> ReturnValue: ...  # noqa: A002 - YARP's names
    def getHorizontalResolution_RPC(self) -> tuple[ReturnValue, float]: ...
    def setHorizontalResolution_RPC(self, step: float) -> ReturnValue: ...
    def getScanRate_RPC(self) -> tuple[ReturnValue, float]: ...
    def setScanRate_RPC(self, rate: float) -> ReturnValue: ...
    def getDeviceInfo_RPC(self) -> tuple[ReturnValue, str]: ...


@rpc
@before(Generation.YARP_3_11)
class OlderVocabs(Service):
    """The vocabs of clients before 3.10: distances, directions, resolution, rate, description."""

    def get_ilas_lsdr(self) -> VocabReply: ...
    def get_ilas_lsar(self) -> VocabReply: ...
    def get_ilas_lsas(self) -> VocabReply: ...
    def get_ilas_lssr(self) -> VocabReply: ...
    def get_ilas_lsnf(self) -> VocabReply: ...
    def set_ilas_lsdr(self, min: float, max: float) -> bool: ...  # noqa: A002 - YARP's names
    def set_ilas_lsar(self, min: float, max: float) -> bool: ...  # noqa: A002 - YARP's names
    def set_ilas_lsas(self, step: float) -> bool: ...
    def set_ilas_lssr(self, rate: float) -> bool: ...


def _getter(quantity: str, method: Callable[..., Any]) -> Callable[[Any], VocabReply]:
    def ask(self: Any) -> VocabReply:
        outcome, *values = getattr(self, method.__name__)()
        if not outcome:
            raise CallFailed(outcome.code)
        return VocabReply(quantity, *values)

    return ask


def _setter(method: Callable[Concatenate[Any, P], ReturnValue]) -> Callable[Concatenate[Any, P], bool]:
    def do(self: Any, /, *arguments: P.args, **named: P.kwargs) -> bool:
        outcome = getattr(self, method.__name__)(*arguments, **named)
        if not outcome:
            raise CallFailed(outcome.code)
        return True

    return do


class Rangefinder2D(IRangefinder2DMsgs, OlderVocabs):
    """A laser for clients of every release; the older vocabs call the newer methods."""

    get_ilas_lsdr = _getter("lsdr", IRangefinder2DMsgs.getDistanceRange_RPC)
    get_ilas_lsar = _getter("lsar", IRangefinder2DMsgs.getScanLimits_RPC)
    get_ilas_lsas = _getter("lsas", IRangefinder2DMsgs.getHorizontalResolution_RPC)
    get_ilas_lssr = _getter("lssr", IRangefinder2DMsgs.getScanRate_RPC)
    get_ilas_lsnf = _getter("lsnf", IRangefinder2DMsgs.getDeviceInfo_RPC)
    set_ilas_lsdr = _setter(IRangefinder2DMsgs.setDistanceRange_RPC)
    set_ilas_lsar = _setter(IRangefinder2DMsgs.setScanLimits_RPC)
    set_ilas_lsas = _setter(IRangefinder2DMsgs.setHorizontalResolution_RPC)
    set_ilas_lssr = _setter(IRangefinder2DMsgs.setScanRate_RPC)
