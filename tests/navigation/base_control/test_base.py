"""The commands of ``/baseControl/rpc``, and their effects on a base."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest

from navigation.base_control.base import HELP, BaseCommands, DrivenBase
from navigation.base_control.commands import Velocity
from navigation.base_control.section import BaseControlSection
from navigation.base_control.settings import resolved


@pytest.fixture
def base() -> DrivenBase:
    return DrivenBase(resolved(BaseControlSection())[0])


@pytest.fixture
def commands(base: DrivenBase) -> BaseCommands:
    return BaseCommands(base)


def drive(base: DrivenBase, velocity: Velocity, seconds: float = 2.0, start: float = 100.0) -> Velocity:
    for step in range(round(seconds / 0.02)):
        base.inputs["ros"].command(velocity, start + step * 0.02)
        base.step(start + step * 0.02)
    return base.limiter.now


def test_help_lists_every_command(commands: BaseCommands) -> None:
    many, *lines = commands.answer(["help"])
    assert (many, tuple(lines)) == ("[many]", HELP)


def test_idle_stops_the_base_until_run(base: DrivenBase, commands: BaseCommands) -> None:
    assert drive(base, Velocity(0.2)).x == pytest.approx(0.2)
    commands.answer(["idle"])
    assert drive(base, Velocity(0.2), start=102.0).x == 0.0
    commands.answer(["run"])
    assert drive(base, Velocity(0.2), start=104.0).x == pytest.approx(0.2)


def test_stopped_wheels_get_fewer_commands_and_motion_starts_immediately(base: DrivenBase) -> None:
    period = base.section.period
    assert period == 0.02
    command = base.inputs["command"]
    sent = []
    for step in range(200):
        now = 100.0 + step * period
        if 100 <= step < 105:
            command.command(Velocity(0.2), now)
        velocities = base.step(now)
        if base.due(velocities):
            sent.append((step, bool(velocities.any())))
    standing = [step for step, turns in sent if not turns and step < 100]
    assert standing[:24] == list(range(24))
    assert {after - before for before, after in itertools.pairwise(standing[24:])} == {2}
    turning = [step for step, turns in sent if turns]
    assert turning == list(range(100, turning[-1] + 1))
    after = [step for step, turns in sent if not turns and step > 100]
    assert after[:24] == list(range(turning[-1] + 1, turning[-1] + 25))


def test_a_base_with_a_slow_period_gets_every_command() -> None:
    base = DrivenBase(resolved(BaseControlSection(period=0.05))[0])
    assert all(base.due(base.step(100.0 + step * 0.05)) for step in range(40))


def test_limits_can_be_lowered_but_not_raised_above_the_robots(base: DrivenBase, commands: BaseCommands) -> None:
    commands.answer(["set_max_lin_vel", 0.1])
    commands.answer(["set_max_ang_vel", 10])
    assert drive(base, Velocity(0.2, 0.0, 1.0)) == pytest.approx((0.1, 0.0, math.radians(10)))
    with pytest.raises(ValueError, match=r"at most 0.3 m/s"):
        commands.answer(["set_max_lin_vel", 3.0])
    commands.answer(["set_max_lin_vel", 0.3])
    assert base.limiter.limits.linear == 0.3


def test_joystick_speeds_are_set(base: DrivenBase, commands: BaseCommands) -> None:
    commands.answer(["set_max_joy_lin_vel", 0.2])
    commands.answer(["set_max_joy_ang_vel", 20])
    assert base.full == (0.2, 20.0)


def test_filters_are_set(base: DrivenBase, commands: BaseCommands) -> None:
    commands.answer(["set_prefilter", 2])
    commands.answer(["set_motors_filter", 8])
    assert (base.limiter.limits.filter_hz, base.motors_filter) == (2, 8)


def test_odometry_is_reset_and_its_velocity_smoothed(base: DrivenBase, commands: BaseCommands) -> None:
    base.motors_filter = 1
    base.measured([0.0, 0.0], 1.0)
    traveled = base.measured([0.02, 0.02], 1.02)
    assert 0.0 < traveled.velocity.x < 0.16416
    assert traveled.x == pytest.approx(0.02 * 0.16416)
    assert commands.answer(["reset_odometry"]) == ["Odometry reset done."]
    assert base.odometry.now.x == 0.0


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ([], "unknown command"),
        (["dance"], "unknown command 'dance'"),
        (["set_prefilter", 3], "0, 1, 2, 4, 8"),
        (["set_prefilter"], "0, 1, 2, 4, 8"),
        (["set_max_lin_vel"], "not nothing"),
        (["set_max_lin_vel", math.nan], "not nan"),
        (["set_max_lin_vel", "fast"], "not fast"),
        (["set_max_lin_vel", -0.1], "above 0"),
        (["change_pid", "linear", 1, 0, 0], "nothing was changed"),
    ],
)
def test_invalid_commands_are_rejected(commands: BaseCommands, values: list[Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        commands.answer(values)


def test_a_clock_jump_keeps_the_pose_and_drops_commands(base: DrivenBase) -> None:
    drive(base, Velocity(0.2))
    base.measured([0.0, 0.0], 100.0)
    base.measured([1.0, 1.0], 101.0)
    base.restart()
    base.measured([5.0, 5.0], 1.0)
    assert base.odometry.now.x == pytest.approx(0.16416)
    base.step(1.0)
    assert base.choice.input == ""
