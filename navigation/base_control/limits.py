"""The limits of a base: from the command to the velocities of its wheels.

In each period, the command is smoothed (input filter), cut to the allowed velocities (speeds, the ratio of driving and
turning, motors), and approached no faster than the accelerations allow. The allowed velocities are a convex set, and
steps stay inside it, so that no limit is ever exceeded, not even for one period.

Robotology/navigation's ``baseControl2`` limits the acceleration first and scales afterwards, which lets a wheel's
limit brake the base harder than the limit of its acceleration allows; the ratio limiter compares percent with meters
per second and so never acts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from navigation.base_control.commands import STILL, Velocity
from navigation.base_control.kinematics import Array, Kinematics

_NEAR = 1e-12


@dataclass(frozen=True)
class BaseLimits:
    """The velocity and acceleration limits of a base."""

    linear: float = 0.3  #: m/s
    angular: float = math.radians(30.0)  #: rad/s
    linear_acceleration: float = 0.3  #: m/s2, speeding up
    linear_braking: float = 0.3  #: m/s2
    angular_acceleration: float = math.radians(80.0)  #: rad/s2, speeding up
    angular_braking: float = math.radians(80.0)  #: rad/s2
    # the largest velocity of any wheel, rad/s; all are slowed alike, so that the path stays the same
    wheel: float = math.radians(100.0)
    # the share of driving if driving and turning together exceed 100 percent of their maxima; with None each may reach
    # its own maximum
    ratio: float | None = None
    filter_hz: int = 0  #: cut-off frequency of the input filter, 0 for none


class Limiter:
    """Keeps a base within its limits, which may be replaced while it drives; call `step` once per period."""

    def __init__(self, kinematics: Kinematics, limits: BaseLimits) -> None:
        self.kinematics, self.limits = kinematics, limits
        self.now = STILL  # the velocity that `step` returned last
        self._smooth = STILL

    def step(self, wanted: Velocity, seconds: float) -> Velocity:
        """Return the velocity for the next period."""
        if wanted == self._smooth == self.now == STILL:
            return self.now
        if not self.kinematics.holonomic:
            wanted = Velocity(wanted.x, 0.0, wanted.turn)
        self._smooth = low_pass(self._smooth, wanted, self.limits.filter_hz, seconds)
        target = limited(self._smooth, self.kinematics, self.limits)
        # the limits may have been lowered while the base drives
        start = limited(self.now, self.kinematics, self.limits)
        self.now = self._approach(start, target, seconds)
        return self.now

    def stop(self) -> None:
        """Stop at once, without the braking limit, for an emergency stop."""
        self.now = self._smooth = STILL

    def wheels(self) -> Array:
        """Return the wheels' velocities for the last velocity, rad/s."""
        return self.kinematics.wheels(self.now)

    def _approach(self, start: Velocity, target: Velocity, seconds: float) -> Velocity:
        """Step toward the target for one period: each axis separately if the limits allow, else in proportion."""
        linear, turn = self._allowed_shares(start, target, seconds)
        separate = Velocity(
            start.x + (target.x - start.x) * linear,
            start.y + (target.y - start.y) * linear,
            start.turn + (target.turn - start.turn) * turn,
        )
        if _is_within(separate, self.kinematics, self.limits):
            return separate
        share = min(linear, turn)
        return _interpolate(start, target, share)

    def _allowed_shares(self, start: Velocity, target: Velocity, seconds: float) -> tuple[float, float]:
        """Return the shares of the wanted changes in driving and turning that one period allows."""
        limits = self.limits
        change = math.hypot(target.x - start.x, target.y - start.y)
        speeding = target.speed > start.speed
        linear = (limits.linear_acceleration if speeding else limits.linear_braking) * seconds
        turning = target.turn - start.turn
        faster = abs(target.turn) > abs(start.turn)
        angular = (limits.angular_acceleration if faster else limits.angular_braking) * seconds
        return min(1.0, linear / max(change, _NEAR)), min(1.0, angular / max(abs(turning), _NEAR))


def limited(velocity: Velocity, kinematics: Kinematics, limits: BaseLimits) -> Velocity:
    """Return the velocity reduced to the limits, in the same direction."""
    share = min(1.0, limits.linear / max(velocity.speed, _NEAR))
    turn = max(-limits.angular, min(limits.angular, velocity.turn))
    cut = Velocity(velocity.x * share, velocity.y * share, turn)
    if limits.ratio is not None:
        cut = _apply_ratio(cut, limits, limits.ratio)
    fastest = kinematics.fastest(cut)
    if fastest > limits.wheel:
        share = limits.wheel / fastest
        cut = Velocity(cut.x * share, cut.y * share, cut.turn * share)
    return cut


def _apply_ratio(velocity: Velocity, limits: BaseLimits, ratio: float) -> Velocity:
    """Reduce driving and turning so that together they are at most 100 percent of their maxima."""
    linear = velocity.speed / limits.linear if limits.linear else 0.0
    turn = abs(velocity.turn) / limits.angular if limits.angular else 0.0
    if linear + turn <= 1.0:
        return velocity
    allowed = ratio if turn > 1.0 - ratio and linear > ratio else min(linear, 1.0 - turn) if linear > ratio else linear
    along = allowed / linear if linear else 0.0
    around = min(1.0, (1.0 - allowed) / turn) if turn else 0.0
    return Velocity(velocity.x * along, velocity.y * along, velocity.turn * around)


def _is_within(velocity: Velocity, kinematics: Kinematics, limits: BaseLimits) -> bool:
    cut = limited(velocity, kinematics, limits)
    return abs(cut.x - velocity.x) + abs(cut.y - velocity.y) + abs(cut.turn - velocity.turn) <= 1e-9


def low_pass(before: Velocity, wanted: Velocity, hertz: int, seconds: float) -> Velocity:
    """Apply one step of a first-order low-pass filter with this cut-off frequency; 0 for none."""
    if hertz <= 0:
        return wanted
    share = 1.0 - math.exp(-2.0 * math.pi * hertz * seconds)
    return _interpolate(before, wanted, share)


def _interpolate(a: Velocity, b: Velocity, share: float) -> Velocity:
    return Velocity(a.x + (b.x - a.x) * share, a.y + (b.y - a.y) * share, a.turn + (b.turn - a.turn) * share)
