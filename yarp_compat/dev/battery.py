"""A battery: its stream, the service of its RPC port (`IBatteryMsgs.thrift`), and a client (`IBattery.h`).

Ports (`battery_nws_yarp`, formerly `batteryWrapper`): the stream ``<name>/data:o``, and ``<name>/rpc:i``. From 3.12
on, the stream consists of `BatteryData`. Before 3.12, it is a Bottle of the same numbers in another order (voltage,
current, charge, temperature, status), and the RPC port uses vocabs: the reply to ``[ibat] [btnf]`` is
``[is] [btnf] "..."``.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - the names are those of YARP's .thrift file

from __future__ import annotations

from collections.abc import MutableSequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Unpack

from yarp_compat.dev.client import ClientOptions, StreamingClient
from yarp_compat.dev.fields import Generated
from yarp_compat.dev.rangefinder import VocabReply
from yarp_compat.dev.returnvalue import OK, UNREACHED, ReturnValue, deliver, results_of
from yarp_compat.dev.service import Service, before, rpc
from yarp_compat.overriding import override
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
    """The method of a battery's port, which returns a text that describes the battery."""

    def getBatteryInfoRPC(self) -> tuple[ReturnValue, str]: ...


@rpc
@before(Generation.YARP_3_12)
class OlderBatteryVocabs(Service):
    """The same method in the vocabs of YARP before 3.12."""

    def ibat_btnf(self) -> VocabReply: ...


class _BatteryCalls(IBatteryMsgs, OlderBatteryVocabs):
    """The methods of all releases; a server has some of them."""


class IBattery:
    """A battery under YARP's names: each method returns a value, or stores it in a list of one element.

    An unknown value is 0, empty, or ``BATTERY_GENERAL_ERROR``, as in the bindings.
    """

    (
        BATTERY_OK_STANDBY, BATTERY_OK_IN_CHARGE, BATTERY_OK_IN_USE, BATTERY_GENERAL_ERROR, BATTERY_TIMEOUT,
        BATTERY_LOW_WARNING, BATTERY_CRITICAL_WARNING,
    ) = BatteryStatus  # fmt: skip

    def newest(self) -> BatteryData | None:
        """Return the newest message; None before the first."""
        raise NotImplementedError

    def description(self) -> tuple[ReturnValue, str]:
        """Return the outcome and the description of the battery."""
        raise NotImplementedError

    def getBatteryVoltage(self, voltage: MutableSequence[float] | None = None) -> Any:
        """Return the voltage in volts."""
        return self._value("voltage", voltage)

    def getBatteryCurrent(self, current: MutableSequence[float] | None = None) -> Any:
        """Return the current in amperes."""
        return self._value("current", current)

    def getBatteryCharge(self, charge: MutableSequence[float] | None = None) -> Any:
        """Return the charge in percent."""
        return self._value("charge", charge)

    def getBatteryTemperature(self, temperature: MutableSequence[float] | None = None) -> Any:
        """Return the temperature in degrees Celsius."""
        return self._value("temperature", temperature)

    def getBatteryStatus(self, status: MutableSequence[int] | None = None) -> Any:
        """Return a `BatteryStatus`, or the number of an unknown status."""
        return self._value("status", status)

    def getBatteryInfo(self, battery_info: MutableSequence[str] | None = None) -> Any:
        """Return the description of the battery."""
        return deliver(*self.description(), battery_info)

    def _value(self, name: str, into: Any) -> Any:
        data = self.newest()
        value = getattr(data or BatteryData(), name)
        if name == "status" and value in tuple(BatteryStatus):
            value = BatteryStatus(value)
        return deliver(UNREACHED if data is None else OK, value, into)


class BatteryClient(StreamingClient[_BatteryCalls, BatteryData], IBattery):
    """A client that receives a battery's state, like YARP's ``battery_nwc_yarp``.

    ``server`` is the prefix of the server's ports (``/robot/battery``), ``name`` the prefix of the client's
    ports; ``carrier`` is the stream's carrier. For the other arguments, see `ServiceClient`.
    """

    def __init__(self, server: str, name: str = "", carrier: str = "", **options: Unpack[ClientOptions]) -> None:
        rpc_port, stream_port = name and f"{name}/rpc:o", name and f"{name}/data:i"
        super().__init__(
            _BatteryCalls, f"{server}/rpc:i", rpc_port, f"{server}/data:o", BatteryData, stream_port, carrier, **options
        )

    @override
    def newest(self) -> BatteryData | None:
        last = self.last()
        return None if last is None else last[0]

    @override
    def description(self) -> tuple[ReturnValue, str]:
        if self.version is not None:
            outcome, *info = results_of(self.remote.getBatteryInfoRPC)
            return outcome, info[0] if outcome else ""
        try:
            return OK, str(self.remote.ibat_btnf().values[0])
        except (OSError, WireError):
            return UNREACHED, ""

    @override
    def _converted(self, received: tuple[BatteryData, float] | None) -> tuple[BatteryData, float] | None:
        """Reorder the numbers of servers before 3.12, which send voltage, current, charge."""
        if received is None or self.version is not None:
            return received
        old, stamp = received  # its fields hold the old order's numbers
        return BatteryData(old.current, old.charge, old.voltage, old.temperature, old.status), stamp
