"""The threads of zenoh's library in a process that carries messages."""

from __future__ import annotations

import os
from collections.abc import MutableMapping

VARIABLE = "ZENOH_RUNTIME"
"""What zenoh reads its threads' number and tasks from, when its first session is opened."""

_RECEIVE_ON_ONE_THREAD = "(rx: (worker_threads: 1), acc: (handover: rx))"


def receive_on_one_thread(environ: MutableMapping[str, str] = os.environ) -> None:
    """Have one thread handle what comes, on links that were accepted also wait for it; before any session is opened.

    By default one thread waits for a socket, wakes a second one that reads and handles a message, and that wakes a
    third one in case that more is to do: about 30 us of a message's way (benchmarks/topic_latency.py). zenoh's own
    tasks (``net``) keep their thread, as sending does: Python's lock is held while a latched publisher's task is ended
    (zenoh-ext 1.10), and a receiving thread that waits for that lock could not run it, for ten seconds. A setting that
    is there already stays.
    """
    environ.setdefault(VARIABLE, _RECEIVE_ON_ONE_THREAD)
