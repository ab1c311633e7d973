"""Events that record for how long threads wait for them."""

from __future__ import annotations

import threading

from typing_extensions import override


def recorded_waits() -> tuple[type[threading.Event], list[float | None]]:
    """Return a type of event, and the list of the timeouts with which threads wait for such events, in seconds."""
    timeouts = list[float | None]()

    class RecordedEvent(threading.Event):
        @override
        def wait(self, timeout: float | None = None) -> bool:
            timeouts.append(timeout)
            return super().wait(timeout)

    return RecordedEvent, timeouts
