"""A worker that hangs tells where: the daemon's signal has it write the stacks of its threads to its stderr."""

from __future__ import annotations

import faulthandler
import signal

TELL_STACKS: signal.Signals | None = getattr(signal, "SIGUSR1", None)


def tell_stacks_on_signal() -> None:
    """Answer the signal. It works without Python's lock, so also where that lock is what all threads wait for."""
    if TELL_STACKS is not None:
        faulthandler.register(TELL_STACKS, all_threads=True)
