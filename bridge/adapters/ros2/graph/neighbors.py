"""Detects participants on the network that this participant's shared memory cannot reach.

Fast DDS offers shared memory to every participant whose GUID prefix begins with this host's four bytes. If such a
participant belongs to another user, or to a container with a separate /dev/shm, Fast DDS does not notice that, and
silently delivers nothing. The prefix's bytes 4 and 5 are the low half of the process id (observed with Fast DDS
2.14.5). So a participant that can share memory has a process on this host with such an id, of the same user, with Fast
DDS loaded, and with the same /dev/shm.

Fast DDS 2 and 3 announce shared memory in different ways (locators of kind 0x10 and 0x13), and name its files
differently. Neither uses the other's files: messages between them use UDP, which works between users.

A participant that was killed just after its start has no process either, and stays on the graph until its lease ends.
While fewer of the domain's ports are bound than participants of this host are known, one of these participants has died
(a container with a separate network has another host's prefix).
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from bridge.adapters.ros2.graph.origins import is_marked, is_secured
from bridge.adapters.ros2.graph.spdp import discovery_ports
from bridge.adapters.ros2.releases import SHARED_MEMORY
from bridge.concurrency import DelayedCalls
from bridge.hub.shared_memory import FOLDER, YOUNG_SECONDS, is_locked, room_trouble
from bridge.state_file import keep

CONFIRM_SECONDS = 1.0
"""Pause before a second check, because a program that has just ended may still be on the graph without a process."""

LEASE_SECONDS = 25.0
"""Seconds after which a dead participant has left the graph, if it had Fast DDS's lease of 20 s."""

_HOST = slice(0, 4)
_PID = slice(4, 6)
_LIBRARIES = {major: f"/lib{name}.so.{major}".encode() for major, name in SHARED_MEMORY.items()}
_NOTE = "udp-alone"


class MemoryNeighbors:
    """Calls ``on_unreachable`` for a participant that shared memory cannot reach, although Fast DDS offers it.

    Args:
        own: this participant's GUID prefix.
        major: the major version of its Fast DDS.
        domain: its ROS domain.
        on_unreachable: called once, on a thread of ``later``.
        later: for delayed checks.
        proc: the process table.
        folder: the folder of the files in shared memory.
    """

    def __init__(
        self,
        own: bytes,
        major: int,
        domain: int,
        on_unreachable: Callable[[], None],
        later: DelayedCalls,
        *,
        proc: Path = Path("/proc"),
        folder: Path = FOLDER,
    ) -> None:
        self._own, self._major, self._domain, self._on_unreachable = own, major, domain, on_unreachable
        self._later, self._proc, self._folder = later, proc, folder
        self._lock = threading.Lock()
        self._present: frozenset[bytes] = frozenset()
        self._reachable: set[bytes] = set()
        self._other_majors: set[bytes] = set()
        self._suspected: dict[bytes, float] = {}  # since when, on the monotonic clock
        self._confirming = self._done = False

    def follow(self, participants: Collection[bytes]) -> None:
        """Check the participants that are on the network now."""
        with self._lock:
            self._present = frozenset(participants)
            self._reachable &= self._present
            self._other_majors &= self._present
            if not self._done and not self._confirming and self._suspects():
                self._confirm_later()

    def on_other_major(self) -> int:
        """Return the number of participants on this host whose Fast DDS has another major version."""
        with self._lock:
            return len(self._other_majors)

    def _confirm_later(self) -> None:
        self._confirming = True
        self._later.after(CONFIRM_SECONDS, self._confirm)

    def _suspects(self) -> Mapping[bytes, float]:
        """Return the participants that shared memory may not reach, each with the time when it was first suspected."""
        suspects = []
        for prefix in self._present - self._reachable - self._other_majors:
            if prefix[_HOST] != self._own[_HOST] or is_marked(prefix) or is_secured(prefix):
                self._reachable.add(prefix)
                continue
            processes = candidate_processes(self._proc, int.from_bytes(prefix[_PID], "little"))
            majors = {major for process in processes for major in loaded_majors(process)}
            majors = majors or {major for process in processes for major in self._majors_of_other_user(process)}
            if self._major in majors:
                self._reachable.add(prefix)
            elif majors:
                self._other_majors.add(prefix)
            else:
                suspects.append(prefix)
        now = time.monotonic()
        self._suspected = {prefix: self._suspected.get(prefix, now) for prefix in suspects}
        return self._suspected

    def _majors_of_other_user(self, process: Path) -> set[int]:
        """Return the major versions of another user's Fast DDS, from the user's live files in shared memory.

        The memory map of the process is not readable. Empty if the user has live files of this participant's major
        version, because Fast DDS then uses these files, but delivers nothing.
        """
        try:
            uid = process.stat().st_uid
        except OSError:
            return set()
        if uid == os.geteuid():
            return set()
        majors = {major for major in SHARED_MEMORY for owner in live_users(major, self._folder) if owner == uid}
        return set() if self._major in majors else majors

    def _confirm(self) -> None:
        with self._lock:
            self._confirming = False
            if self._done or not (suspects := self._suspects()):
                return
            if self._has_dead_participant() and time.monotonic() < min(suspects.values()) + LEASE_SECONDS:
                self._confirm_later()
                return
            self._done = True
        self._on_unreachable()

    def _has_dead_participant(self) -> bool:
        on_host = {prefix for prefix in self._present if prefix[_HOST] == self._own[_HOST]} | {self._own}
        bound = bound_ports(self._proc)
        return bound is not None and len(bound.intersection(discovery_ports(self._domain))) < len(on_host)

    def close(self) -> None:
        with self._lock:
            self._done = True


def candidate_processes(proc: Path, low: int) -> list[Path]:
    """Return the paths in the process table of all possible process ids with ``low`` as their lower 16 bits."""
    try:
        largest = int((proc / "sys/kernel/pid_max").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        largest = 1 << 22
    return [proc / str(pid) for pid in range(low, largest + 1, 1 << 16)]


def loaded_majors(process: Path) -> set[int]:
    """Return the major versions of Fast DDS that a process of the same user and with the same /dev/shm has loaded."""
    try:
        if process.stat().st_uid != os.geteuid():
            return set()
        maps = (process / "maps").read_bytes()
        other = (process / "root" / FOLDER.relative_to("/")).stat()
        mine = FOLDER.stat()
    except OSError:
        return set()
    if (other.st_dev, other.st_ino) != (mine.st_dev, mine.st_ino):
        return set()
    return {major for major, library in _LIBRARIES.items() if library in maps}


def bound_ports(proc: Path) -> set[int] | None:
    """Return the UDP ports that are bound in this network namespace; None if unknown."""
    sockets = udp_sockets(proc)
    return None if sockets is None else {socket.port for socket in sockets}


class UdpSocket(NamedTuple):
    """A UDP socket; ``drops`` is the number of datagrams that the kernel dropped, mostly for lack of room."""

    port: int
    inode: str
    drops: int


def udp_sockets(proc: Path = Path("/proc"), table: str = "udp") -> list[UdpSocket] | None:
    """Return the UDP sockets in this network namespace (proc_net(5)), ``udp6`` for IPv6; None if unknown."""
    try:
        lines = (proc / "net" / table).read_text(encoding="utf-8").splitlines()[1:]
        sockets = [line.split() for line in lines]
        return [UdpSocket(int(f[1].rpartition(":")[2], 16), f[9], int(f[12])) for f in sockets]
    except (OSError, ValueError, IndexError):
        return None


def prefer_udp(folder: Path) -> None:
    """Make later starts use only UDP, until the machine reboots."""
    keep(folder / _NOTE, _boot_id(), "the next start tries shared memory again")


def prefers_udp(folder: Path) -> bool:
    """Return whether `prefer_udp` was called since the machine booted."""
    try:
        return (folder / _NOTE).read_text(encoding="utf-8") == _boot_id()
    except OSError:
        return False


def _boot_id() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip()
    except OSError:
        return ""


# -- ended processes ---------------------------------------------------------------------------------------------------
# DDS itself notices a kill after 20 s. It decides about participants whose process is not found here, or is another
# user's.

_MOST = 1000


class ProcessWatch:
    """Tracks whether participants' processes have ended; thread-safe. ``own``: this participant's GUID prefix."""

    def __init__(self, own: bytes, proc: Path = Path("/proc")) -> None:
        self._own, self._proc = own, proc
        self._processes: dict[bytes, dict[Path, str]] = {}

    def has_ended(self, prefix: bytes) -> bool:
        """Return whether a participant's process ran here at the first call for it, and has ended since."""
        known = self._processes.get(prefix)
        if known is None:
            if len(self._processes) >= _MOST:
                self._processes.clear()
            known = self._processes[prefix] = self._find(prefix)
        return bool(known) and all(_start_time(process) != start for process, start in known.items())

    def _find(self, prefix: bytes) -> dict[Path, str]:
        if prefix[_HOST] != self._own[_HOST] or is_marked(prefix) or is_secured(prefix):
            return {}
        candidates = candidate_processes(self._proc, int.from_bytes(prefix[_PID], "little"))
        starts = {process: _start_time(process) for process in candidates if loaded_majors(process)}
        return {process: start for process, start in starts.items() if start}


def _start_time(process: Path) -> str:
    """Return a process's start time, "" if it has ended (proc(5): fields 3 and 22 of stat)."""
    try:
        fields = (process / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] in "ZX" else fields[19]


# -- files in shared memory --------------------------------------------------------------------------------------------
# Fast DDS 2 makes ``fastrtps_<hex>`` (a segment) and ``fastrtps_port<n>`` (a port), each with a lock file ``<name>_el``
# that every live user holds locked (flock), and a semaphore ``sem.<port>_mutex``. Those of Fast DDS 3 begin with
# ``fastdds_`` (observed with 2.14.5 and 3.2.3).

LARGEST_SEGMENT = 32 * 1024 * 1024
"""Room for a burst of large messages. Fast DDS writes all of it at creation, so the memory stays allocated."""
SMALLEST_SEGMENT = 8 * 1024 * 1024
"""Below it shared memory has no benefit: large messages would be fragmented again."""
NEEDED_ROOM = 8 * SMALLEST_SEGMENT
"""Minimum free space for using shared memory."""

_LOCK = re.compile(rf"^({'|'.join(SHARED_MEMORY.values())})_(?:[0-9a-f]{{16}}|port\d+)_el$")


def segment_size(folder: Path = FOLDER) -> int:
    """Return the bytes for this participant's segment: an eighth of the free space, at most 32 MiB; 0 if too little."""
    if room_trouble(NEEDED_ROOM, folder):
        return 0
    stat = os.statvfs(folder)
    return min(LARGEST_SEGMENT, stat.f_bavail * stat.f_frsize // 8)


def has_other_users(major: int, folder: Path = FOLDER) -> bool:
    """Return whether live participants of other users, with this major version of Fast DDS, share the folder."""
    mine = os.getuid()
    return any(uid != mine for uid in live_users(major, folder))


def live_users(major: int, folder: Path = FOLDER) -> Iterator[int]:
    """Yield the owner's user id of each live participant's lock file, for participants with this major version."""
    for lock in _locks(folder):
        with contextlib.suppress(OSError):
            if lock.name.startswith(f"{SHARED_MEMORY[major]}_") and is_locked(lock):
                yield lock.stat().st_uid


def clean(folder: Path = FOLDER) -> int:
    """Remove the segments of dead participants, and only those; return their number.

    Ports stay, because Fast DDS itself replaces a dead port when its number is used again, and might do so at the same
    time; for the ports of dead predecessors, see `clean_ports`. A segment's name is never reused.
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
    """Remove dead predecessors' ports, except ports that others keep open because they have not noticed the death."""
    import fcntl

    for port in (f"{name}_port{number}" for number in numbers for name in SHARED_MEMORY.values()):
        with contextlib.suppress(OSError):  # it does not exist, or is in use
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
