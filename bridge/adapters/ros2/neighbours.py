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

import os
import threading
import time
from collections.abc import Callable, Collection
from pathlib import Path

from bridge.adapters.keep import keep
from bridge.adapters.ros2.mark import is_marked
from bridge.adapters.ros2.spdp import discovery_ports
from bridge.hub.pools import FOLDER

CONFIRM_SECONDS = 1.0
"""A program that has just ended may still be on the graph, and has no process any more."""

LEASE_SECONDS = 25.0
"""A dead participant is gone by then, if it had Fast DDS's lease of 20 s."""

_HOST = slice(0, 4)
_PID = slice(4, 6)
_LIBRARIES = (b"libfastrtps", b"libfastdds")
_NOTE = "udp-alone"


class Neighbours:
    """Watches the participants for one that shared memory cannot reach.

    Args:
        own: our GUID prefix.
        domain: the ROS domain.
        stranger: called once, when such a participant stays.
        proc: the process table.
    """

    def __init__(self, own: bytes, domain: int, stranger: Callable[[], None], proc: Path = Path("/proc")) -> None:
        self._own, self._domain, self._stranger, self._proc = own, domain, stranger, proc
        self._lock = threading.Lock()
        self._present: frozenset[bytes] = frozenset()
        self._ours: set[bytes] = set()
        self._timer: threading.Timer | None = None
        self._since = 0.0
        self._done = False

    def follow(self, participants: Collection[bytes]) -> None:
        """Look at the participants that are there now."""
        with self._lock:
            self._present = frozenset(participants)
            self._ours &= self._present
            if not self._done and self._timer is None and self._suspects():
                self._since = time.monotonic()
                self._look_again()

    def _look_again(self) -> None:
        self._timer = threading.Timer(CONFIRM_SECONDS, self._confirm)
        self._timer.daemon = True
        self._timer.start()

    def _suspects(self) -> list[bytes]:
        suspects = []
        for prefix in self._present - self._ours:
            if prefix[_HOST] != self._own[_HOST] or is_marked(prefix) or self._has_process(prefix):
                self._ours.add(prefix)
            else:
                suspects.append(prefix)
        return suspects

    def _confirm(self) -> None:
        with self._lock:
            self._timer = None
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

    def _has_process(self, prefix: bytes) -> bool:
        return any(map(shares_memory, with_low_half(self._proc, int.from_bytes(prefix[_PID], "little"))))

    def close(self) -> None:
        """Watch no more."""
        with self._lock:
            self._done = True
            timer, self._timer = self._timer, None
        if timer is not None:
            timer.cancel()
            if timer is not threading.current_thread():
                timer.join()


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
