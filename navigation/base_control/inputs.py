"""BaseControl's inputs: who commands, and until when.

As in robotology/navigation's ``baseControl2``: inputs have ranks; one that falls silent counts as zero and keeps its
rank for 100 periods, so that a base does not leap from a joystick to an old goal, and then gives back.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass

from navigation.base_control.velocity import STILL, CommandError, Velocity

KEPT_PERIODS = 100
DEFAULT_TIMEOUT = 0.1
"""Seconds after which an input is silent where its section does not say (``max_timeout``)."""

ABSURD = 10.0
"""No base of ours drives (m/s) or turns (rad/s) faster: such a command is an error in its units or its sender."""


class Input:
    """One input, with the last command that came by it. Commands come from any thread.

    Args:
        name: as people know it.
        timeout: seconds after which its last command counts as zero.
    """

    def __init__(self, name: str, timeout: float = DEFAULT_TIMEOUT) -> None:
        self.name, self.timeout = name, timeout
        self.commands = 0
        self.refused = 0
        self._lock = threading.Lock()
        self._last: tuple[Velocity, float, float] | None = None

    def command(self, velocity: Velocity, now: float, timeout: float | None = None) -> None:
        """Take a command.

        Args:
            velocity: what is wanted.
            now: the time, seconds of the clock that `Arbiter.choose` is asked by.
            timeout: a shorter time-out that came with the command.

        Raises:
            CommandError: it holds NaN, infinity or an absurd value. The last good one goes on until its time-out.
        """
        if not all(map(math.isfinite, velocity)):
            self.refused += 1
            raise CommandError(f"{self.name}: a command of NaN or infinity is not obeyed: {_shown(velocity)}")
        if velocity.speed > ABSURD or abs(velocity.turn) > ABSURD:
            self.refused += 1
            raise CommandError(
                f"{self.name}: a command above {ABSURD:g} m/s or {ABSURD:g} rad/s is not obeyed: {_shown(velocity)}; "
                "are its units metres, and degrees or radians, per second as this input expects?"
            )
        until = now + min(self.timeout, timeout if timeout is not None and timeout > 0.0 else self.timeout)
        with self._lock:
            self.commands += 1
            self._last = (velocity, now, until)

    def forget(self) -> None:
        """Forget what was commanded: the clock was set back, or all is to stop."""
        with self._lock:
            self._last = None

    @property
    def last(self) -> tuple[Velocity, float, float] | None:
        """The last command, when it came and until when it holds; None where there was none."""
        return self._last


@dataclass(frozen=True)
class Choice:
    """What one period drives by.

    Attributes:
        velocity: what is commanded; zero where nobody commands or who does is silent.
        input: whose it is, "" for nobody's.
        fresh: whether it is a command, rather than a silent input's zero.
    """

    velocity: Velocity = STILL
    input: str = ""
    fresh: bool = False


NOBODY = Choice()


class Arbiter:
    """Chooses among inputs, once each period.

    Args:
        inputs: the highest rank first.
        period: seconds between two choices.
    """

    def __init__(self, inputs: Sequence[Input], period: float) -> None:
        self.inputs = tuple(inputs)
        self.kept_seconds = KEPT_PERIODS * period

    def choose(self, now: float) -> Choice:
        """What to drive by at this time, seconds."""
        for candidate in self.inputs:
            last = candidate.last
            if last is None:
                continue
            velocity, _, until = last
            if now <= until:
                return Choice(velocity, candidate.name, fresh=True)
            if now <= until + self.kept_seconds:
                return Choice(STILL, candidate.name)
        return NOBODY

    def forget(self) -> None:
        """Forget all commands."""
        for each in self.inputs:
            each.forget()


def _shown(velocity: Velocity) -> str:
    return f"({velocity.x:g} {velocity.y:g} m/s, {velocity.turn:g} rad/s)"
