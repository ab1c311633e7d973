"""For how long this worker may carry messages without another look at who else does."""

from __future__ import annotations

import time


class Lease:
    """A time until which messages may cross. A worker that stood still finds it over, and drops what piled up."""

    __slots__ = ("_until",)

    def __init__(self) -> None:
        self._until = 0.0

    @property
    def over(self) -> bool:
        """Whether nothing may cross now. Quick enough to be asked for each message."""
        return time.monotonic() > self._until

    def extend(self, until: float) -> None:
        """Let messages cross until then, on the monotonic clock."""
        self._until = until

    def end(self) -> None:
        """Let nothing cross any more."""
        self._until = 0.0
