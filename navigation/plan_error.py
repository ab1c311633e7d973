"""Why no way was found, or a goal was not reached."""

from __future__ import annotations

from navigation.status import Fault


class PlanError(ValueError):
    """There is no way.

    Args:
        fault: what is told programs.
        reason: what is told people.
        passing: it may be there soon: only what the laser sees stands in the way.
    """

    def __init__(self, fault: Fault, reason: str, *, passing: bool = False) -> None:
        super().__init__(reason)
        self.fault, self.passing = fault, passing
