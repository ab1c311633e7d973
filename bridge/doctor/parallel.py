"""Work on many things at once, in threads that do not keep the process from ending."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from typing import TypeVar

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


def in_parallel(work: Callable[[Item], Outcome], items: Sequence[Item], threads: int) -> list[Outcome]:
    """``work`` of each item, in the items' order; it must not raise.

    Unlike those of `concurrent.futures` the threads are not waited for when the process ends: the system's resolver has
    no time limit of ours.
    """
    waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
    done: queue.SimpleQueue[tuple[int, Outcome]] = queue.SimpleQueue()
    for number in range(len(items)):
        waiting.put(number)

    def run() -> None:
        while True:
            try:
                number = waiting.get_nowait()
            except queue.Empty:
                return
            done.put((number, work(items[number])))

    for _ in range(min(threads, len(items))):
        threading.Thread(target=run, name="doctor-parallel", daemon=True).start()
    outcomes = dict(done.get() for _ in items)
    return [outcomes[number] for number in range(len(items))]
