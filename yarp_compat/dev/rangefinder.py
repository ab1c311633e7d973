"""What a laser's port answers (`IRangefinder2DMsgs.thrift`), and the same asked in the older words.

Ports (`rangefinder2D_nws_yarp` of YARP 3.6 to 4.0): the stream of LaserScan2D, and beside it ``<name>/rpc:i``. Clients
before 3.10 ask ``[get] [ilas] [lsdr]`` and are answered ``[is] [lsdr] 0.1 20.0`` (`IRangefinder2D.h`).
"""

# mypy: disable-error-code="empty-body"

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

from yarp_compat.dev.fields import Choice
from yarp_compat.dev.returnvalue import CallFailed, ReturnValue
from yarp_compat.dev.service import Service, rpc
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.writer import Writer


class DeviceStatus(IntEnum):
    """How a laser is."""

    DEVICE_OK_STANDBY = 0
    DEVICE_OK_IN_USE = 1
    DEVICE_GENERAL_ERROR = 2
    DEVICE_TIMEOUT = 3


class Told(Portable):
    """An answer in the older words: ``[is]``, what was asked for, and its values.

    Args:
        what: a vocab.
        values: numbers or a text.
    """

    def __init__(self, what: str = "", *values: float | str) -> None:
        self.what, self.values = what, values

    def _write(self, out: Writer) -> None:
        out.begin(2 + len(self.values))
        out.vocab("is")
        out.vocab(self.what)
        for value in self.values:
            if isinstance(value, str):
                out.string(value)
            else:
                out.float64(value)

    def _read(self, source: Reader) -> None:
        count = source.begin()
        source.word()
        self.what = source.word()
        self.values = (source.string(),) if self.what == "lsnf" else tuple(source.float64() for _ in range(count - 2))
        source.end()


class IRangefinder2DMsgs(Service):
    """What a laser's port answers."""

    @rpc
    def getDeviceStatus_RPC(self) -> tuple[ReturnValue, Annotated[DeviceStatus, Choice(DeviceStatus, vocab=True)]]:
        """How it is."""

    @rpc
    def getDistanceRange_RPC(self) -> tuple[ReturnValue, float, float]:
        """The least and greatest distance, metres."""

    @rpc
    def setDistanceRange_RPC(self, min: float, max: float) -> ReturnValue:  # noqa: A002 - YARP's names
        """Have others."""

    @rpc
    def getScanLimits_RPC(self) -> tuple[ReturnValue, float, float]:
        """The first and last direction, degrees."""

    @rpc
    def setScanLimits_RPC(self, min: float, max: float) -> ReturnValue:  # noqa: A002 - YARP's names
        """Have others."""

    @rpc
    def getHorizontalResolution_RPC(self) -> tuple[ReturnValue, float]:
        """Between two rays, degrees."""

    @rpc
    def setHorizontalResolution_RPC(self, step: float) -> ReturnValue:
        """Have another."""

    @rpc
    def getScanRate_RPC(self) -> tuple[ReturnValue, float]:
        """Turns per second."""

    @rpc
    def setScanRate_RPC(self, rate: float) -> ReturnValue:
        """Have another."""

    @rpc
    def getDeviceInfo_RPC(self) -> tuple[ReturnValue, str]:
        """What it is."""


class OlderWords(Service):
    """The same in the words of clients before 3.10."""

    @rpc
    def get_ilas_lsdr(self) -> Told:
        """The least and greatest distance."""

    @rpc
    def get_ilas_lsar(self) -> Told:
        """The first and last direction."""

    @rpc
    def get_ilas_lsas(self) -> Told:
        """The resolution."""

    @rpc
    def get_ilas_lssr(self) -> Told:
        """Turns per second."""

    @rpc
    def get_ilas_lsnf(self) -> Told:
        """What it is."""

    @rpc
    def set_ilas_lsdr(self, min: float, max: float) -> bool:  # noqa: A002 - YARP's names
        """Have other distances."""

    @rpc
    def set_ilas_lsar(self, min: float, max: float) -> bool:  # noqa: A002 - YARP's names
        """Have other directions."""

    @rpc
    def set_ilas_lsas(self, step: float) -> bool:
        """Have another resolution."""

    @rpc
    def set_ilas_lssr(self, rate: float) -> bool:
        """Have another rate."""


class Rangefinder2D(IRangefinder2DMsgs, OlderWords):
    """A laser that answers clients of every release; the older words are made of the newer methods."""

    def get_ilas_lsdr(self) -> Told:
        """The least and greatest distance."""
        return _told("lsdr", self.getDistanceRange_RPC())

    def get_ilas_lsar(self) -> Told:
        """The first and last direction."""
        return _told("lsar", self.getScanLimits_RPC())

    def get_ilas_lsas(self) -> Told:
        """The resolution."""
        return _told("lsas", self.getHorizontalResolution_RPC())

    def get_ilas_lssr(self) -> Told:
        """Turns per second."""
        return _told("lssr", self.getScanRate_RPC())

    def get_ilas_lsnf(self) -> Told:
        """What it is."""
        return _told("lsnf", self.getDeviceInfo_RPC())

    def set_ilas_lsdr(self, min: float, max: float) -> bool:  # noqa: A002 - YARP's names
        """Have other distances."""
        return _done(self.setDistanceRange_RPC(min, max))

    def set_ilas_lsar(self, min: float, max: float) -> bool:  # noqa: A002 - YARP's names
        """Have other directions."""
        return _done(self.setScanLimits_RPC(min, max))

    def set_ilas_lsas(self, step: float) -> bool:
        """Have another resolution."""
        return _done(self.setHorizontalResolution_RPC(step))

    def set_ilas_lssr(self, rate: float) -> bool:
        """Have another rate."""
        return _done(self.setScanRate_RPC(rate))


def _told(what: str, found: tuple[ReturnValue, *tuple[float | str, ...]]) -> Told:
    if not found[0]:
        raise CallFailed(found[0].code)
    return Told(what, *found[1:])


def _done(outcome: ReturnValue) -> bool:
    if not outcome:
        raise CallFailed(outcome.code)
    return True
