"""Which of the network's participants could never be reached through our shared memory.

Fast DDS offers shared memory to every participant whose GUID prefix begins with the same four bytes: those of this
host. It does not see that one belongs to another user, or to a container with a /dev/shm of its own, and then delivers
nothing without a word. The prefix's bytes 4 and 5 are the low half of the process id (seen with Fast DDS 2.14.5), so a
participant that can share memory with us has a process here with such an id, of our user, with Fast DDS loaded, and
with the same /dev/shm.

One that was killed just after it came has no process either, and stays on the graph until its lease ends. While fewer
of the domain's ports are bound than participants of this host are known, somebody of them has died (a container that
has a network of its own has another host's prefix).
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
import time
from collections.abc import Callable, Collection, Iterable
from pathlib import Path

from bridge.adapters.ros2.graph.origins import is_marked
from bridge.adapters.ros2.graph.spdp import discovery_ports
from bridge.concurrency import DelayedCalls
from bridge.hub.shared_memory import FOLDER, YOUNG_SECONDS, is_locked
from bridge.state_file import keep

CONFIRM_SECONDS = 1.0
"""A program that has just ended may still be on the graph, and has no process any more."""

LEASE_SECONDS = 25.0
"""A dead participant is gone by then, if it had Fast DDS's lease of 20 s."""

_HOST = slice(0, 4)
_PID = slice(4, 6)
_LIBRARIES = (b"libfastrtps", b"libfastdds")
_NOTE = "udp-alone"


class MemoryNeighbours:
    """Watches for a participant that shared memory cannot reach: then calls ``stranger``. ``own``: our GUID prefix."""

    def __init__(
        self, own: bytes, domain: int, stranger: Callable[[], None], later: DelayedCalls, proc: Path = Path("/proc")
    ) -> None:
        self._own, self._domain, self._stranger, self._later, self._proc = own, domain, stranger, later, proc
        self._lock = threading.Lock()
        self._present: frozenset[bytes] = frozenset()
        self._ours: set[bytes] = set()
        self._since = 0.0
        self._confirming = self._done = False

    def follow(self, participants: Collection[bytes]) -> None:
        """Look at the participants that are there now."""
        with self._lock:
            self._present = frozenset(participants)
            self._ours &= self._present
            if not self._done and not self._confirming and self._suspects():
                self._since = time.monotonic()
                self._look_again()

    def _look_again(self) -> None:
        self._confirming = True
        self._later.after(CONFIRM_SECONDS, self._confirm)

    def _suspects(self) -> list[bytes]:
        suspects = []
        for prefix in self._present - self._ours:
            processes = with_low_half(self._proc, int.from_bytes(prefix[_PID], "little"))
            if prefix[_HOST] != self._own[_HOST] or is_marked(prefix) or any(map(shares_memory, processes)):
                self._ours.add(prefix)
            else:
                suspects.append(prefix)
        return suspects

    def _confirm(self) -> None:
        with self._lock:
            self._confirming = False
            if self._done or not self._suspects():
                return
            if self._somebody_died() and time.monotonic() < self._since + LEASE_SECONDS:
                self._look_again()
                return
            self._done = True
        self._stranger()

    def _somebody_died(self) -> bool:
        here = {prefix for prefix in self._present if prefix[_HOST] == self._own[_HOST]} | {self._own}
        bound = bound_ports(self._proc)
        return bound is not None and len(bound.intersection(discovery_ports(self._domain))) < len(here)

    def close(self) -> None:
        """Stop watching."""
        with self._lock:
            self._done = True


def with_low_half(proc: Path, low: int) -> list[Path]:
    """Where the processes would be in the process table whose ids have this low half."""
    try:
        largest = int((proc / "sys/kernel/pid_max").read_text())
    except (OSError, ValueError):
        largest = 1 << 22
    return [proc / str(pid) for pid in range(low, largest + 1, 1 << 16)]


def shares_memory(process: Path) -> bool:
    """Whether a process is our user's, has Fast DDS loaded, and has the same /dev/shm."""
    try:
        if process.stat().st_uid != os.geteuid():
            return False
        maps = (process / "maps").read_bytes()
        other = (process / "root" / FOLDER.relative_to("/")).stat()
        mine = FOLDER.stat()
    except OSError:
        return False
    same_folder = (other.st_dev, other.st_ino) == (mine.st_dev, mine.st_ino)
    return same_folder and any(library in maps for library in _LIBRARIES)


def bound_ports(proc: Path) -> set[int] | None:
    """The UDP ports that sockets of this network namespace have (proc_net(5)); None where that is not to be known."""
    try:
        lines = (proc / "net/udp").read_text().splitlines()[1:]
        return {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
    except (OSError, ValueError, IndexError):
        return None


def note(folder: Path) -> None:
    """Have the next starts use UDP alone, until the machine is booted anew."""
    keep(folder / _NOTE, _boot(), "the next start tries shared memory again")


def noted(folder: Path) -> bool:
    """Whether `note` was called since the machine was booted."""
    try:
        return (folder / _NOTE).read_text() == _boot()
    except OSError:
        return False


def _boot() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


# -- ended processes ---------------------------------------------------------------------------------------------------
# DDS itself notices a kill after 20 s. A participant whose process is not found here, or is another user's, is left to
# DDS.

_MOST = 1000


class ProcessWatch:
    """Remembers participants' processes, and knows which have ended; for any thread. ``own``: our GUID prefix."""

    def __init__(self, own: bytes, proc: Path = Path("/proc")) -> None:
        self._own, self._proc = own, proc
        self._processes: dict[bytes, dict[Path, str]] = {}

    def is_gone(self, prefix: bytes) -> bool:
        """Whether a participant's process was here when it was first asked for, and has ended since."""
        known = self._processes.get(prefix)
        if known is None:
            if len(self._processes) >= _MOST:
                self._processes.clear()
            known = self._processes[prefix] = self._find(prefix)
        return bool(known) and all(_start(process) != start for process, start in known.items())

    def _find(self, prefix: bytes) -> dict[Path, str]:
        if prefix[_HOST] != self._own[_HOST] or is_marked(prefix):
            return {}
        candidates = with_low_half(self._proc, int.from_bytes(prefix[_PID], "little"))
        found = {process: _start(process) for process in candidates if shares_memory(process)}
        return {process: start for process, start in found.items() if start}


def _start(process: Path) -> str:
    """When a process was started, "" where it has ended (proc(5): fields 3 and 22 of stat)."""
    try:
        fields = (process / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else fields[19]


# -- files in shared memory --------------------------------------------------------------------------------------------
# Fast DDS 2.14 makes ``fastrtps_<hex>`` (a segment) and ``fastrtps_port<n>`` (a port), each with a lock file
# ``<name>_el`` that every living user holds locked (flock), and a semaphore ``sem.<port>_mutex``.

LARGEST_SEGMENT = 32 * 1024 * 1024
"""Room for a burst of large messages. Fast DDS writes all of it when it is made, so that it is taken for good."""
SMALLEST_SEGMENT = 8 * 1024 * 1024
"""Below it shared memory is not worth having: large messages would go in pieces again."""

_LOCK = re.compile(r"^(fastrtps_(?:[0-9a-f]{16}|port\d+))_el$")


def segment_size(folder: Path = FOLDER) -> int:
    """Bytes for our segment: an eighth of what is free, at most 32 MiB; 0 where that is too little."""
    try:
        stat = os.statvfs(folder)
    except OSError:
        return 0
    size = min(LARGEST_SEGMENT, stat.f_bavail * stat.f_frsize // 8)
    return size if size >= SMALLEST_SEGMENT else 0


def other_users(folder: Path = FOLDER) -> bool:
    """Whether living Fast DDS participants of other users share the folder."""
    mine = os.getuid()
    for lock in _locks(folder):
        with contextlib.suppress(OSError):
            if lock.stat().st_uid != mine and is_locked(lock):
                return True
    return False


def clean(folder: Path = FOLDER) -> int:
    """Remove the segments of dead participants, and only those; how many.

    Ports stay: Fast DDS itself replaces a dead one when its number comes up again, and would meet us at it; but for
    those of our own dead, see `clean_ports`. A segment's name is never used again.
    """
    removed = 0
    for lock in _locks(folder):
        name = lock.name.removesuffix("_el")
        with contextlib.suppress(OSError):
            old = time.time() - lock.stat().st_mtime > YOUNG_SECONDS
            if old and "port" not in name and not is_locked(lock):
                (folder / name).unlink(missing_ok=True)
                lock.unlink(missing_ok=True)
                removed += 1
    return removed


def clean_ports(numbers: Iterable[int], folder: Path = FOLDER) -> None:
    """Remove our dead participants' ports, but for those in use: others have them open until they learn of it."""
    import fcntl

    for number in numbers:
        port = f"fastrtps_port{number}"
        with contextlib.suppress(OSError):  # there is none, or it is in use
            descriptor = os.open(folder / f"{port}_el", os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                for name in (port, f"sem.{port}_mutex", f"{port}_el"):
                    (folder / name).unlink(missing_ok=True)
            finally:
                os.close(descriptor)


def _locks(folder: Path) -> list[Path]:
    try:
        return [p for p in folder.iterdir() if _LOCK.match(p.name)]
    except OSError:
        return []
