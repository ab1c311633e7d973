"""The clock of the YARP programs, beside that of the run."""

from __future__ import annotations

import time

from bridge.clock import RunClock

_DAY = 86_400.0


class YarpClock:
    """The time as YARP programs have it, in seconds, and their stamps in the run's time.

    With a simulated run they may be on its clock (a network clock) or still on the system's; a stamp tells by its scale
    which of them its writer has.

    Args:
        run: the run's clock.
        follows: YARP programs that read are on the run's clock; else on the system's.
    """

    def __init__(self, run: RunClock, *, follows: bool) -> None:
        self._run = run
        self._follows = follows or not run.simulated

    def now(self) -> float:
        """The time of those who read."""
        return self._run.now_ns() / 1e9 if self._follows else time.time()

    def age(self, stamp: float) -> float:
        """Seconds since a stamp, on the clock of who wrote it."""
        system = time.time()
        if self._run.simulated and abs(system - stamp) > _DAY:
            return self._run.now_ns() / 1e9 - stamp
        return system - stamp

    def seen(self, stamp: float) -> float:
        """A writer's stamp as those who read have it."""
        return self.now() - self.age(stamp) if self._run.simulated else stamp

    def of_run(self, stamp: float) -> int:
        """A writer's stamp in ns of the run's clock."""
        return self._run.now_ns() - round(self.age(stamp) * 1e9) if self._run.simulated else round(stamp * 1e9)
