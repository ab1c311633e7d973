"""Detects ports of Fast DDS at which a process still listens, although their files in shared memory were removed.

A participant receives at a port, which is a file in shared memory. If the port's thread does not run for one to two
seconds, because the process is suspended or the machine is busy, the participants that write to the port consider it
dead. At each message they remove it, create one with the same name, and remove that again because nobody listens at
it. When the thread runs again, it creates the port, too. Fast DDS (2.14.5) guards this with a mutex that it removes
together with the port, so that both ends may hold one at the same time. If a writer then removes the port that the
thread is just creating, the participant listens at a file without a name. From then on it receives nothing over
shared memory, although it is discovered, and what it sends arrives (`open_port_internal` and `~Port` in
SharedMemGlobal.hpp; observed between two rclpy programs, twice in some 400 suspensions with 1,000 messages per
second, never in 280 with 75).
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from pathlib import Path

from bridge.adapters.ros2.releases import SHARED_MEMORY
from bridge.concurrency import DelayedCalls
from bridge.hub.shared_memory import FOLDER

PERIOD = 10.0
"""Seconds between two checks, each of which takes up to 3 ms."""

CONFIRM_SECONDS = 2.0
"""Seconds until a second check, because the port's thread may still replace the port: it wakes up three times a second,
and then waits for the mutex."""

_PORT = rf"(?:{'|'.join(SHARED_MEMORY.values())})_port\d+"
_FILE = re.compile(rf"(?P<folder>/.*)/(?P<port>{_PORT})(?P<lock>_el)?(?: \(deleted\))?")
_IN_MAPS = re.compile(rf"^.*/{_PORT}(?: \(deleted\))?$", re.MULTILINE)


def lost_ports(process: Path = Path("/proc/self"), folder: Path = FOLDER) -> frozenset[str]:
    """Return the names of the ports at which a process listens, but whose file it does not have mapped.

    ``process`` is its path in the process table (proc(5)). A process locks (``<name>_el``) the ports at which it
    listens, but not those to which it writes. Empty if the process is another user's, or has ended.
    """
    mapped: dict[str, set[int]] = {}
    with contextlib.suppress(OSError):
        for line in _IN_MAPS.findall((process / "maps").read_text(encoding="utf-8", errors="replace")):
            *_, inode, path = line.split(maxsplit=5)
            if port := _port(path, folder, lock=False):
                mapped.setdefault(port, set()).add(int(inode))
    own_folder = process / "root" / folder.relative_to("/")  # a container may have another
    replaced = {name for name, inodes in mapped.items() if _inode(own_folder / name) not in inodes}
    return frozenset(replaced & locked_ports(process, folder)) if replaced else frozenset()


def locked_ports(process: Path, folder: Path = FOLDER) -> set[str]:
    """Return the names of the ports that a process has locked."""
    names = set[str]()
    with contextlib.suppress(OSError):
        for descriptor in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                names.add(_port(str(descriptor.readlink()), folder, lock=True))
    return names - {""}


def _port(path: str, folder: Path, *, lock: bool) -> str:
    """Return the name of the port whose file, or lock, has this path; "" if it is another file."""
    match = _FILE.fullmatch(path)
    return match["port"] if match and match["folder"] == str(folder) and bool(match["lock"]) == lock else ""


def _inode(path: Path) -> int | None:
    try:
        return path.stat().st_ino
    except OSError:
        return None


class PortWatch:
    """Calls ``on_lost``, on a thread of ``later``, at each check that finds a lost port of this process."""

    def __init__(
        self, on_lost: Callable[[], None], later: DelayedCalls, lost: Callable[[], frozenset[str]] = lost_ports
    ) -> None:
        self._on_lost, self._later, self._lost = on_lost, later, lost
        self._suspects: frozenset[str] = frozenset()
        later.every(PERIOD, self._check)

    def check(self) -> None:
        """Check soon, because this process was suspended."""
        self._later.after(CONFIRM_SECONDS, self._check, once=True)

    def _check(self) -> None:
        self._suspects = self._lost()
        if self._suspects:
            self._later.after(CONFIRM_SECONDS, self._confirm, once=True)

    def _confirm(self) -> None:
        if self._suspects & self._lost():
            self._on_lost()
