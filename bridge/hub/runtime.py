"""The threads of zenoh's library in a process that carries messages."""

from __future__ import annotations

import os
from collections.abc import MutableMapping

VARIABLE = "ZENOH_RUNTIME"
"""What zenoh reads its threads' number and tasks from, when its first session is opened."""

_RECEIVE_ON_ONE_THREAD = "(rx: (worker_threads: 1), net: (handover: rx), acc: (handover: rx))"


def receive_on_one_thread(environ: MutableMapping[str, str] = os.environ) -> None:
    """Have one thread wait for the links' sockets and handle what comes; to be called before any session is opened.

    By default one thread waits for a socket, wakes a second one that reads and handles a message, and that wakes a
    third one in case that more is to do: about 30 us of a message's way (benchmarks/topic_latency.py). Sending has a
    thread of its own as before. A setting that is there already stays.
    """
    environ.setdefault(VARIABLE, _RECEIVE_ON_ONE_THREAD)
