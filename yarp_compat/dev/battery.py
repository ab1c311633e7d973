"""A battery: its stream, the service of its port (`IBatteryMsgs.thrift`), and a client (`IBattery.h`).

Ports (`battery_nws_yarp`, once `batteryWrapper`): the stream ``<name>/data:o``, and ``<name>/rpc:i``. From 3.12 on the
stream is of `BatteryData`. Before it is a Bottle of the same numbers in another order (voltage, current, charge,
temperature, status), and the port answers older words: ``[ibat] [btnf]`` by ``[is] [btnf] "..."``.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - names and arguments are those of YARP's .thrift file, and say what each does

from __future__ import annotations

from collections.abc import MutableSequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Unpack

from yarp_compat.dev.client import ClientOptions, StreamingClient
from yarp_compat.dev.fields import Generated
from yarp_compat.dev.rangefinder import OldAnswer
from yarp_compat.dev.returnvalue import OK, UNREACHED, ReturnValue, answered, given
from yarp_compat.dev.service import Service, before, rpc
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import Generation


class BatteryStatus(IntEnum):
    """The state of a battery."""

    BATTERY_OK_STANDBY = 0
    BATTERY_OK_IN_CHARGE = 1
    BATTERY_OK_IN_USE = 2
    BATTERY_GENERAL_ERROR = 3
    BATTERY_TIMEOUT = 4
    BATTERY_LOW_WARNING = 5
    BATTERY_CRITICAL_WARNING = 6


@dataclass
class BatteryData(Generated):
    """The state of a battery: percent, volts, amperes, degrees Celsius, and a `BatteryStatus`."""

    charge: float = 0.0
    voltage: float = 0.0
    current: float = 0.0
    temperature: float = 0.0
    status: int = 3

    def older(self) -> list[float | int]:
        """Return the Bottle that clients before 3.12 read instead (``battery_nwc_yarp.cpp``)."""
        return [self.voltage, self.current, self.charge, self.temperature, self.status]


@rpc
class IBatteryMsgs(Service):
    """The method of a battery's port: a text of what kind of battery it is."""

    def getBatteryInfoRPC(self) -> tuple[ReturnValue, str]: ...


@rpc
@before(Generation.YARP_3_12)
class OlderBatteryWords(Service):
    """The same in the words of YARP before 3.12."""

    def ibat_btnf(self) -> OldAnswer: ...


class _BatteryCalls(IBatteryMsgs, OlderBatteryWords):
    """What servers of any release answer, some of it."""


class IBattery:
    """A battery under YARP's names: each method returns a value, or has a list's one element become it.

    A value that is not known is 0, empty, or ``BATTERY_GENERAL_ERROR``, as in the bindings.
    """

    (
        BATTERY_OK_STANDBY, BATTERY_OK_IN_CHARGE, BATTERY_OK_IN_USE, BATTERY_GENERAL_ERROR, BATTERY_TIMEOUT,
        BATTERY_LOW_WARNING, BATTERY_CRITICAL_WARNING,
    ) = BatteryStatus  # fmt: skip

    def newest(self) -> BatteryData | None:
        """Return the latest message; None before the first."""
        raise NotImplementedError

    def described(self) -> tuple[ReturnValue, str]:
        """The outcome, and what kind of battery it is."""
        raise NotImplementedError

    def getBatteryVoltage(self, voltage: MutableSequence[float] | None = None) -> Any:
        """Volts."""
        return self._found("voltage", voltage)

    def getBatteryCurrent(self, current: MutableSequence[float] | None = None) -> Any:
        """Amperes."""
        return self._found("current", current)

    def getBatteryCharge(self, charge: MutableSequence[float] | None = None) -> Any:
        """Percent."""
        return self._found("charge", charge)

    def getBatteryTemperature(self, temperature: MutableSequence[float] | None = None) -> Any:
        """Degrees Celsius."""
        return self._found("temperature", temperature)

    def getBatteryStatus(self, status: MutableSequence[int] | None = None) -> Any:
        """A `BatteryStatus`, or the number of one that is not known."""
        return self._found("status", status)

    def getBatteryInfo(self, battery_info: MutableSequence[str] | None = None) -> Any:
        """What kind of battery it is."""
        return given(*self.described(), battery_info)

    def _found(self, name: str, into: Any) -> Any:
        data = self.newest()
        value = getattr(data or BatteryData(), name)
        if name == "status" and value in tuple(BatteryStatus):
            value = BatteryStatus(value)
        return given(UNREACHED if data is None else OK, value, into)


class BatteryClient(StreamingClient[_BatteryCalls, BatteryData], IBattery):
    """Receives a battery's state, as YARP's ``battery_nwc_yarp`` does.

    ``server`` begins the names of its ports (``/robot/battery``), ``name`` the own ones; ``carrier`` is the stream's;
    more as of `ServiceClient`.
    """

    def __init__(self, server: str, name: str = "", carrier: str = "", **options: Unpack[ClientOptions]) -> None:
        own, said = name and f"{name}/rpc:o", name and f"{name}/data:i"
        super().__init__(
            _BatteryCalls, f"{server}/rpc:i", own, f"{server}/data:o", BatteryData, said, carrier, **options
        )

    def newest(self) -> BatteryData | None:
        """Return the latest message; None before the first."""
        last = self.last()
        return None if last is None else last[0]

    def described(self) -> tuple[ReturnValue, str]:
        """The outcome, and what kind of battery it is."""
        if self.version is not None:
            outcome, *info = answered(self.remote.getBatteryInfoRPC)
            return outcome, info[0] if outcome else ""
        try:
            return OK, str(self.remote.ibat_btnf().values[0])
        except (OSError, WireError):
            return UNREACHED, ""

    def _meant(self, received: tuple[BatteryData, float] | None) -> tuple[BatteryData, float] | None:
        """Before 3.12 the numbers were voltage, current, charge."""
        if received is None or self.version is not None:
            return received
        said, stamp = received
        return BatteryData(said.current, said.charge, said.voltage, said.temperature, said.status), stamp
