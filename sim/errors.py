"""What goes wrong in the simulator."""

from __future__ import annotations


class SimError(RuntimeError):
    """It cannot be done; the text says what, where and how to mend it."""
