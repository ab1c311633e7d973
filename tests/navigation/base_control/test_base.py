"""The words of ``/baseControl/rpc``, and how a base obeys them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from bridge.config.sections.base_control import BaseControlSection
from navigation.base_control.base import HELP, BaseCommands, DrivenBase
from navigation.base_control.commands import Velocity
from navigation.base_control.settings import resolved


@pytest.fixture
def base() -> DrivenBase:
    return DrivenBase(resolved(BaseControlSection())[0])


@pytest.fixture
def words(base: DrivenBase) -> BaseCommands:
    return BaseCommands(base)


def drive(base: DrivenBase, velocity: Velocity, seconds: float = 2.0, start: float = 100.0) -> Velocity:
    for step in range(round(seconds / 0.02)):
        base.inputs["ros"].command(velocity, start + step * 0.02)
        base.step(start + step * 0.02)
    return base.limiter.now


def test_help_tells_every_word(words: BaseCommands) -> None:
    many, *lines = words.answer(["help"])
    assert (many, tuple(lines)) == ("[many]", HELP)


def test_idle_and_run(base: DrivenBase, words: BaseCommands) -> None:
    assert drive(base, Velocity(0.2)).x == pytest.approx(0.2)
    words.answer(["idle"])
    assert drive(base, Velocity(0.2), start=102.0).x == 0.0
    words.answer(["run"])
    assert drive(base, Velocity(0.2), start=104.0).x == pytest.approx(0.2)


def test_limits_are_lowered_and_never_raised_above_the_robots_own(base: DrivenBase, words: BaseCommands) -> None:
    words.answer(["set_max_lin_vel", 0.1])
    words.answer(["set_max_ang_vel", 10])
    assert drive(base, Velocity(0.2, 0.0, 1.0)) == pytest.approx((0.1, 0.0, math.radians(10)))
    with pytest.raises(ValueError, match=r"at most 0.3 m/s"):
        words.answer(["set_max_lin_vel", 3.0])
    words.answer(["set_max_lin_vel", 0.3])
    assert base.limiter.limits.linear == 0.3


def test_joysticks(base: DrivenBase, words: BaseCommands) -> None:
    words.answer(["set_max_joy_lin_vel", 0.2])
    words.answer(["set_max_joy_ang_vel", 20])
    assert base.full == (0.2, 20.0)


def test_filters(base: DrivenBase, words: BaseCommands) -> None:
    words.answer(["set_prefilter", 2])
    words.answer(["set_motors_filter", 8])
    assert (base.limiter.limits.filter_hz, base.motors_filter) == (2, 8)


def test_odometry_is_reset_and_its_velocity_smoothed(base: DrivenBase, words: BaseCommands) -> None:
    base.motors_filter = 1
    base.measured(np.zeros(2), 1.0)
    found = base.measured(np.ones(2) * 0.02, 1.02)
    assert 0.0 < found.velocity.x < 0.16416
    assert found.x == pytest.approx(0.02 * 0.16416)
    assert words.answer(["reset_odometry"]) == ["Odometry reset done."]
    assert base.odometry.now.x == 0.0


@pytest.mark.parametrize(
    ("values", "says"),
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
def test_words_that_are_none(words: BaseCommands, values: list[Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        words.answer(values)


def test_a_clock_that_is_set_back_leaves_the_pose_and_no_command(base: DrivenBase) -> None:
    drive(base, Velocity(0.2))
    base.measured(np.zeros(2), 100.0)
    base.measured(np.ones(2), 101.0)
    base.forget()
    base.measured(np.ones(2) * 5.0, 1.0)
    assert base.odometry.now.x == pytest.approx(0.16416)
    base.step(1.0)
    assert base.choice.input == ""
