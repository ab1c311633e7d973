"""Which input controls the base, and for how long."""

from __future__ import annotations

import math

import pytest

from navigation.base_control.commands import (
    NO_CHOICE,
    STILL,
    Arbiter,
    CommandChoice,
    CommandError,
    CommandInput,
    FullControl,
    Velocity,
    of_bottle,
    of_degrees,
)

FORWARD, BACK = Velocity(0.2), Velocity(-0.1)
FULL = FullControl(linear=0.4, angular=40.0)


@pytest.fixture
def inputs() -> list[CommandInput]:
    return [CommandInput("joystick", 0.2), CommandInput("navigation", 0.5)]


@pytest.fixture
def arbiter(inputs: list[CommandInput]) -> Arbiter:
    return Arbiter(inputs, 0.02)


def test_no_input_has_commanded(arbiter: Arbiter) -> None:
    assert arbiter.choose(1.0) == NO_CHOICE


def test_a_command_is_active_until_its_timeout(arbiter: Arbiter, inputs: list[CommandInput]) -> None:
    inputs[1].command(FORWARD, 1.0)
    assert arbiter.choose(1.5) == CommandChoice(FORWARD, "navigation", fresh=True)
    assert arbiter.choose(1.51) == CommandChoice(STILL, "navigation")


def test_a_joystick_outranks_navigation_until_100_periods_after_its_timeout(
    arbiter: Arbiter, inputs: list[CommandInput]
) -> None:
    def choose(now: float) -> CommandChoice:
        inputs[1].command(FORWARD, now)  # navigation never stops publishing
        return arbiter.choose(now)

    inputs[0].command(BACK, 1.0)
    assert choose(1.2) == CommandChoice(BACK, "joystick", fresh=True)
    assert choose(1.21) == CommandChoice(STILL, "joystick")
    assert choose(3.2) == CommandChoice(STILL, "joystick")
    assert choose(3.21) == CommandChoice(FORWARD, "navigation", fresh=True)


def test_a_command_can_only_shorten_the_timeout(arbiter: Arbiter, inputs: list[CommandInput]) -> None:
    inputs[1].command(FORWARD, 1.0, timeout=0.1)
    assert not arbiter.choose(1.2).fresh
    inputs[1].command(FORWARD, 2.0, timeout=9.0)
    assert not arbiter.choose(2.6).fresh


@pytest.mark.parametrize(
    ("velocity", "reason"),
    [
        (Velocity(math.nan), "NaN or infinity"),
        (Velocity(turn=-math.inf), "NaN or infinity"),
        (Velocity(8.0, 8.0), "above 10 m/s"),
        (Velocity(turn=30.0), "check that its units"),
    ],
)
def test_invalid_commands_are_rejected_and_the_last_valid_one_stays(
    arbiter: Arbiter, inputs: list[CommandInput], velocity: Velocity, reason: str
) -> None:
    inputs[1].command(FORWARD, 1.0)
    with pytest.raises(CommandError, match=reason):
        inputs[1].command(velocity, 1.4)
    assert arbiter.choose(1.4).velocity == FORWARD
    assert not arbiter.choose(1.6).fresh
    assert (inputs[1].commands, inputs[1].refused) == (1, 1)


def test_clear_drops_all_commands(arbiter: Arbiter, inputs: list[CommandInput]) -> None:
    inputs[0].command(FORWARD, 1.0)
    arbiter.clear()
    assert arbiter.choose(1.0) == NO_CHOICE


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ((1, 0.0, 50.0, -100.0, 100.0), Velocity(0.2, 0.0, math.radians(-40.0))),
        ((2, 90.0, 0.3, 10.0, 100.0), Velocity(0.0, 0.3, math.radians(10.0))),
        ((2, 180.0, 0.3, 10.0, 50.0), Velocity(-0.15, 0.0, math.radians(5.0))),
        ((3, 0.1, -0.2, 20.0, 100.0), Velocity(0.1, -0.2, math.radians(20.0))),
        ((3, 0.1, -0.2, 20.0), Velocity(0.1, -0.2, math.radians(20.0))),
    ],
)
def test_bottles_are_parsed(values: tuple[float, ...], wanted: Velocity) -> None:
    assert of_bottle(values, FULL) == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ((), "five numbers"),
        ((2, 0.0, 0.1), "five numbers"),
        ((2, "a", 0.1, 0.0, 100.0), "five numbers"),
        ((4, 0.0, 0.1, 0.0, 100.0), r"1 \(percent\)"),
        ((2, 0.0, 0.1, 0.0, 101.0), "gain"),
        ((2, math.nan, 0.1, 0.0, 100.0), "direction"),
        ((1, 0.0, 101.0, 0.0, 100.0), "percent"),
        ((1, 0.0, math.nan, 0.0, 100.0), "percent"),
    ],
)
def test_invalid_bottles_are_rejected(values: tuple[object, ...], reason: str) -> None:
    with pytest.raises(CommandError, match=reason):
        of_bottle(values, FULL)


def test_degrees_are_converted() -> None:
    assert of_degrees(0.1, 0.2, 180.0) == pytest.approx((0.1, 0.2, math.pi))
