"""Which commands of BaseControl's topics are too old."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest.mock import MagicMock

import pytest

from navigation.base_control import ports
from navigation.base_control.commands import STILL, CommandInput, FullControl, Velocity
from navigation.base_control.section import BaseControlSection, BaseInput

TWIST, JOY = "geometry_msgs/msg/Twist", "sensor_msgs/msg/Joy"
HELD = {"axes": [0.0, 1.0], "buttons": [0, 0, 0, 0, 1]}


def twist(x: float) -> dict[str, Any]:
    return {"linear": {"x": x, "y": 0.0}, "angular": {"z": 0.0}}


class Inputs:
    """One input with topics, whose commands have an age that the test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.receive: dict[str, Callable[[Any], None]] = {}
        self.target, self.stalls, self.ages, host = CommandInput("ros"), MagicMock(), MagicMock(), MagicMock()
        self.stalls.stood_still.return_value = False
        monkeypatch.setattr(ports, "AgeGate", lambda: self.ages)

        def subscribe(_topic: str, kind: str, receive: Callable[[Any], None], _qos: Any) -> Any:
            self.receive[kind] = receive
            return MagicMock(sender=b"sender", sent_ns=1)

        host.node.subscription.side_effect = subscribe
        base = MagicMock(inputs={"ros": self.target}, full=FullControl(1.0, 90.0))
        section = BaseControlSection(inputs=(BaseInput(name="ros", twist=("/cmd_vel",), joy=("/joy",)),))
        self.inputs = ports.CommandInputs(host, section, base, lambda: 0.0, self.stalls)

    def command(
        self, kind: str, message: dict[str, Any], age: float = 0.0, *, stalled: bool = False
    ) -> Velocity | None:
        """Receive a command; return the input's command then."""
        self.ages.age.return_value, self.stalls.stood_still.return_value = age, stalled
        self.receive[kind](message)
        return None if self.target.last is None else self.target.last[0]


@pytest.mark.parametrize("late", [{"age": 5.0}, {"stalled": True}])
def test_a_late_zero_stops_the_base(monkeypatch: pytest.MonkeyPatch, late: dict[str, Any]) -> None:
    base, moving = Inputs(monkeypatch), Velocity(0.2)
    assert base.command(TWIST, twist(0.2)) == moving
    assert base.command(TWIST, twist(0.3), **late) == moving
    assert base.inputs.stale == 1
    assert base.command(TWIST, twist(0.0), **late) == STILL
    assert base.command(JOY, HELD) == Velocity(1.0)
    assert base.command(JOY, {"axes": [], "buttons": []}, **late) == STILL, "the button was released"
    assert base.inputs.stale == 1
