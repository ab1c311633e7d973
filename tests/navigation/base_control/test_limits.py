"""No limit is ever exceeded, for any command."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navigation.base_control.commands import STILL, Velocity
from navigation.base_control.kinematics import Array, Kinematics, kinematics
from navigation.base_control.limits import BaseLimits, Limiter, limited

PERIOD = 0.02
BASES = {"cer": kinematics("cer", 0.16416, 0.338), "ikart_V1": kinematics("ikart_V1", 0.075, 0.276)}
SPEEDS = st.one_of(st.floats(-1.0, 1.0), st.floats(-10.0, 10.0), st.just(0.0))
VELOCITIES = st.builds(Velocity, SPEEDS, SPEEDS, SPEEDS)
PERIODS = st.integers(1, 6)
LIMITS = st.builds(
    BaseLimits,
    linear=st.floats(0.05, 2.0),
    angular=st.floats(0.05, 3.0),
    linear_acceleration=st.floats(0.05, 3.0),
    linear_braking=st.floats(0.05, 3.0),
    angular_acceleration=st.floats(0.05, 3.0),
    angular_braking=st.floats(0.05, 3.0),
    wheel=st.floats(0.2, 10.0),
    ratio=st.one_of(st.none(), st.floats(0.0, 1.0)),
    filter_hz=st.sampled_from((0, 1, 2, 4, 8)),
)


def check(base: Kinematics, limits: BaseLimits, before: Velocity, after: Velocity, wheels: Array) -> None:
    little = 1e-6
    assert after.speed <= limits.linear + little
    assert abs(after.turn) <= limits.angular + little
    assert max(map(abs, wheels)) <= limits.wheel + little
    from_wheels = base.velocity(wheels)
    assert abs(from_wheels.x - after.x) + abs(from_wheels.y - after.y) + abs(from_wheels.turn - after.turn) <= little
    if limits.ratio is not None:
        assert after.speed / limits.linear + abs(after.turn) / limits.angular <= 1.0 + little
    change = math.hypot(after.x - before.x, after.y - before.y)
    assert change <= max(limits.linear_acceleration, limits.linear_braking) * PERIOD + little
    assert after.speed - before.speed <= limits.linear_acceleration * PERIOD + little
    assert abs(after.turn) - abs(before.turn) <= limits.angular_acceleration * PERIOD + little
    turned = max(limits.angular_acceleration, limits.angular_braking) * PERIOD
    assert abs(after.turn - before.turn) <= turned + little


COMMANDS = st.lists(st.tuples(VELOCITIES, PERIODS), min_size=1, max_size=5)


@pytest.mark.parametrize("kind", BASES)
@settings(max_examples=300)
@given(limits=LIMITS, commands=COMMANDS)
def test_wheel_commands_stay_within_all_limits(
    kind: str, limits: BaseLimits, commands: list[tuple[Velocity, int]]
) -> None:
    check_all(BASES[kind], limits, commands)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", BASES)
def test_many_wheel_commands_stay_within_all_limits(kind: str) -> None:
    """Without Hypothesis, which would take most of the time; pytest-randomly sets the seed."""
    for _ in range(2000):
        commands = [(some_velocity(), random.randint(1, 6)) for _ in range(random.randint(1, 5))]
        check_all(BASES[kind], some_limits(), commands)


def between(low: float, high: float) -> float:
    return random.choice((low, high, *(random.uniform(low, high) for _ in range(6))))


def some_velocity() -> Velocity:
    return Velocity(*(random.choice((0.0, between(-1.0, 1.0), between(-10.0, 10.0))) for _ in range(3)))


def some_limits() -> BaseLimits:
    return BaseLimits(
        linear=between(0.05, 2.0),
        angular=between(0.05, 3.0),
        linear_acceleration=between(0.05, 3.0),
        linear_braking=between(0.05, 3.0),
        angular_acceleration=between(0.05, 3.0),
        angular_braking=between(0.05, 3.0),
        wheel=between(0.2, 10.0),
        ratio=random.choice((None, between(0.0, 1.0))),
        filter_hz=random.choice((0, 1, 2, 4, 8)),
    )


def check_all(base: Kinematics, limits: BaseLimits, commands: list[tuple[Velocity, int]]) -> None:
    limiter = Limiter(base, limits)
    for wanted, periods in commands:
        for _ in range(periods):
            before = limiter.now
            check(base, limits, before, limiter.step(wanted, PERIOD), limiter.wheels())


def driven(limiter: Limiter, wanted: Velocity, periods: int) -> Velocity:
    for _ in range(periods):
        limiter.step(wanted, PERIOD)
    return limiter.now


def test_an_allowed_velocity_is_reached_and_left() -> None:
    limiter = Limiter(BASES["cer"], BaseLimits())
    assert driven(limiter, Velocity(0.2, 0.0, 0.1), 60) == pytest.approx((0.2, 0.0, 0.1))
    assert driven(limiter, STILL, 60) == STILL


def test_speeding_up_and_braking_have_their_own_limits() -> None:
    limiter = Limiter(BASES["cer"], BaseLimits(linear_acceleration=0.1, linear_braking=1.0))
    assert limiter.step(Velocity(0.2), PERIOD).x == pytest.approx(0.002)
    driven(limiter, Velocity(0.2), 200)
    assert limiter.step(STILL, PERIOD).x == pytest.approx(0.18)


def test_a_differential_base_ignores_sideways_motion() -> None:
    assert driven(Limiter(BASES["cer"], BaseLimits()), Velocity(0.1, 0.2, 0.0), 100) == pytest.approx((0.1, 0.0, 0.0))
    assert driven(Limiter(BASES["ikart_V1"], BaseLimits(wheel=100.0)), Velocity(0.1, 0.2), 100).y == pytest.approx(0.2)


def test_slowing_too_fast_wheels_keeps_the_path() -> None:
    fast = limited(Velocity(0.3, 0.0, 0.5), BASES["cer"], BaseLimits())
    assert float(np.abs(BASES["cer"].wheels(fast)).max()) == pytest.approx(math.radians(100.0))
    assert fast.x / fast.turn == pytest.approx(0.3 / 0.5)


@pytest.mark.parametrize(
    ("percent", "left"),
    [((90, 5), (90, 5)), ((100, 50), (70, 30)), ((100, 10), (90, 10)), ((50, 100), (50, 50)), ((100, 0), (100, 0))],
)
def test_driving_and_turning_share_100_percent(percent: tuple[int, int], left: tuple[int, int]) -> None:
    limits = BaseLimits(linear=1.0, angular=1.0, wheel=1000.0, ratio=0.7)
    cut = limited(Velocity(percent[0] / 100, 0.0, -percent[1] / 100), BASES["cer"], limits)
    assert cut == pytest.approx((left[0] / 100, 0.0, -left[1] / 100))


def test_lowered_limits_apply_immediately() -> None:
    limiter = Limiter(BASES["cer"], BaseLimits(linear_acceleration=10.0))
    driven(limiter, Velocity(0.25), 50)
    limiter.limits = BaseLimits(linear=0.1)
    assert limiter.step(Velocity(0.25), PERIOD).x <= 0.1


def test_the_input_filter_smooths_commands() -> None:
    quick = BaseLimits(linear_acceleration=1000.0, angular_acceleration=1000.0, filter_hz=1)
    limiter = Limiter(BASES["cer"], quick)
    tenth = driven(limiter, Velocity(0.2), 1).x
    assert 0.0 < tenth < 0.2 * 0.2
    assert driven(limiter, Velocity(0.2), round(1 / (2 * math.pi) / PERIOD) - 1).x == pytest.approx(
        0.2 * 0.63, rel=0.05
    )


def test_an_emergency_stop_ignores_the_braking_limit() -> None:
    limiter = Limiter(BASES["cer"], BaseLimits())
    driven(limiter, Velocity(0.2), 50)
    limiter.stop()
    assert limiter.now == STILL
    assert not limiter.wheels().any()
