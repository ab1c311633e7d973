"""Files that killed processes leave in shared memory: after one kill, and after many."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from benchmarks.losses.field import ANCHORS, WORKERS, Field
from benchmarks.losses.outcome import Watch
from benchmarks.rows import Row

SETTLE = 6.0
"""Seconds for which a worker runs before it is killed. Younger files of Fast DDS may still be in creation, so they are
removed only at the next start."""


def _steady(field: Field) -> None:
    outcome = Watch(field).until_steady(time.monotonic())
    if not outcome.recovered:
        msg = f"{outcome}\n{field.words()}"
        raise RuntimeError(msg)


def _kill_workers(field: Field) -> None:
    pids = {name: field.worker(name).pid for name in WORKERS}
    for name in WORKERS:
        field.worker(name).kill()

    def replaced() -> bool:
        now = {w.worker: w.pid for w in field.document().workers}
        return all(now.get(name) not in (None, 0, pid) for name, pid in pids.items())

    field.until(replaced, "the workers are restarted")


def _kill_all(field: Field) -> None:
    for name in WORKERS:
        field.worker(name).kill()
    field.kill_daemon()
    field.start_daemon()


WAYS: dict[str, Callable[[Field], None]] = {"the workers": _kill_workers, "the daemon and its workers": _kill_all}


def litter(field: Field, kills: int, ways: Sequence[str] = tuple(WAYS)) -> list[Row]:
    """Kill the workers, and then the whole daemon, repeatedly while megabytes are bridged, and count the leftovers.

    The rows' peers are the leftovers after the first kill.
    """
    for name in ANCHORS:
        field.command(name, "large", "enlarged", on=True)
    rows = []
    for target in ways:
        counts = []
        for number in range(kills):
            _steady(field)
            time.sleep(SETTLE)
            field.shared_memory()
            WAYS[target](field)
            _steady(field)
            counts.append(field.shared_memory())
            files, size = counts[-1]
            print(f"{target} killed {number + 1}/{kills}: {files} files, {size / 1e6:.1f} MB", flush=True)
        first, last = counts[0], counts[-1]
        rows.append(Row(f"files in shared memory after {kills} kills of {target}", last[0], first[0], "files"))
        rows.append(Row(f"shared memory after {kills} kills of {target}", last[1] / 1e6, first[1] / 1e6, "MB"))
    for name in ANCHORS:
        field.command(name, "large", "enlarged", on=False)
    return rows
