"""The battery: what the base has left."""

from __future__ import annotations

from dataclasses import dataclass

from sim.robot import Battery as Description

_EFFICIENCY = 0.7
"""Of the motors: what they put out of what they take."""


@dataclass(frozen=True)
class Charge:
    """Its state.

    Attributes:
        voltage: volts.
        current: amperes, negative while it gives.
        share: 0 to 1.
        capacity: ampere hours when full.
    """

    voltage: float
    current: float
    share: float
    capacity: float


class Battery:
    """Runs down with time and with what the motors take; at zero it stays there, and the base goes on."""

    def __init__(self, described: Description) -> None:
        self._described = described
        self._left = described.capacity
        self._power = described.idle

    def use(self, motors: float, seconds: float) -> None:
        """The motors put out so many watts for so long."""
        self._power = self._described.idle + motors / _EFFICIENCY
        self._left = max(0.0, self._left - self._power * seconds / 3600.0)

    @property
    def charge(self) -> Charge:
        """Its state now."""
        share = self._left / self._described.capacity
        full, empty = self._described.full, self._described.empty
        voltage = empty + (full - empty) * share
        capacity = self._described.capacity / ((full + empty) / 2)
        return Charge(voltage, -self._power / voltage, share, capacity)
