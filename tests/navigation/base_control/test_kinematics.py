"""Conversions between wheels and velocities, compared with the formulas of robotology/navigation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navigation.base_control.commands import Velocity
from navigation.base_control.kinematics import KINDS, KinematicsError, WheelOdometry, kinematics

SPEEDS = st.floats(-1.0, 1.0)
RADIUS, DISTANCE = 0.16416, 0.338


@given(x=SPEEDS, turn=SPEEDS)
def test_two_wheels_match_upstreams_formulas(x: float, turn: float) -> None:
    deg = math.degrees(turn)
    left = x / RADIUS * (180 / math.pi) - deg * DISTANCE / (2 * RADIUS)
    right = x / RADIUS * (180 / math.pi) + deg * DISTANCE / (2 * RADIUS)
    base = kinematics("cer", RADIUS, DISTANCE)
    np.testing.assert_allclose(np.degrees(base.wheels(Velocity(x, 0.0, turn))), [left, right], atol=1e-9)


@given(x=SPEEDS, y=SPEEDS, turn=SPEEDS)
def test_three_wheels_match_upstreams_formulas(x: float, y: float, turn: float) -> None:
    speed, direction = math.hypot(x, y) * 360 / (2 * math.pi * RADIUS), math.degrees(math.atan2(y, x))
    share = math.degrees(turn) * DISTANCE / RADIUS
    wanted = [-speed * math.cos(math.radians(direction + lean)) - share for lean in (-150, -30, 90)]
    base = kinematics("ikart_V1", RADIUS, DISTANCE)
    np.testing.assert_allclose(np.degrees(base.wheels(Velocity(x, y, turn))), wanted, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@given(x=SPEEDS, y=SPEEDS, turn=SPEEDS)
def test_velocities_survive_the_round_trip_through_wheels(kind: str, x: float, y: float, turn: float) -> None:
    base = kinematics(kind, RADIUS, DISTANCE)
    wanted = Velocity(x, y if base.holonomic else 0.0, turn)
    assert base.velocity(base.wheels(wanted)) == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize(("kind", "reason"), [("ikart_V2", "'ikart_V2'"), ("", "use cer or ikart_V1")])
def test_unknown_kinds_are_rejected(kind: str, reason: str) -> None:
    with pytest.raises(KinematicsError, match=reason):
        kinematics(kind, RADIUS, DISTANCE)


@pytest.mark.parametrize("radius", [0.0, -1.0, math.nan, 160.0])
def test_invalid_dimensions_are_rejected(radius: float) -> None:
    with pytest.raises(KinematicsError, match="geom_r"):
        kinematics("cer", radius, DISTANCE)


@pytest.mark.parametrize("kind", KINDS)
@given(x=SPEEDS, y=SPEEDS, turn=st.floats(-3.0, 3.0), steps=st.integers(1, 7))
def test_an_arc_is_integrated_exactly_at_any_encoder_rate(
    kind: str, x: float, y: float, turn: float, steps: int
) -> None:
    base = kinematics(kind, RADIUS, DISTANCE)
    y = y if base.holonomic else 0.0
    odometry = WheelOdometry(base)
    for step in range(steps + 1):
        passed = 2.0 * step / steps
        odometry.update((base.wheels(Velocity(x, y, turn)) * passed).tolist(), 10.0 + passed)
    traveled = odometry.now
    fine = 20_000  # midpoints of small straight pieces
    angles = turn * (np.arange(fine) + 0.5) * 2.0 / fine
    along = np.array([np.sum(x * np.cos(angles) - y * np.sin(angles)), np.sum(x * np.sin(angles) + y * np.cos(angles))])
    np.testing.assert_allclose([traveled.x, traveled.y], along * 2.0 / fine, atol=1e-6)
    assert traveled.theta == pytest.approx(2.0 * turn, abs=1e-9)
    assert traveled.velocity == pytest.approx((x, y, turn), abs=1e-9)
    assert traveled.angle == pytest.approx(2.0 * abs(turn), abs=1e-9)
    assert traveled.distance == pytest.approx(2.0 * math.hypot(x, y), abs=1e-9)


def test_restarted_encoders_do_not_move_the_base() -> None:
    odometry = WheelOdometry(kinematics("cer", RADIUS, DISTANCE))
    odometry.update([5.0, 5.0], 1.0)
    odometry.update([6.0, 6.0], 2.0)
    assert odometry.now.x == pytest.approx(RADIUS)
    odometry.restart()
    odometry.update([0.0, 0.0], 3.0)
    assert odometry.now.x == pytest.approx(RADIUS)
    odometry.update([1.0, 1.0], 2.5)  # not newer
    assert odometry.now.x == pytest.approx(RADIUS)
    odometry.reset()
    assert (odometry.now.x, odometry.now.distance) == (0.0, 0.0)


@pytest.mark.parametrize("angles", [[1.0], [1.0, math.nan], [[1.0, 2.0]]])
def test_invalid_encoder_values_are_rejected(angles: list[float]) -> None:
    with pytest.raises(ValueError, match="2 finite wheel angles"):
        WheelOdometry(kinematics("cer", RADIUS, DISTANCE)).update(angles, 1.0)
