"""Receive buffers of the UDP sockets: the kernel's limit, and the datagrams that the kernel dropped for lack of room.

DDS sends a message of more than 64 kB as several datagrams at once. If the receiver's buffer has no room for one of
them, a best-effort message is lost, and no program reports that. Measured with Fast DDS 2.14.5 between two network
namespaces joined by a veth link, with 40 images of 1 MB at 10 Hz:

- A participant with Fast DDS's default settings keeps the kernel's default (``net.core.rmem_default``, 208 KiB), and
  receives 15 to 20 images. With a buffer of 4 MiB it receives all of them.
- If a profile requests more than ``net.core.rmem_max``, Fast DDS accepts what the kernel grants. With a limit of 208
  KiB, the default before Linux 6.18, here simulated by a smaller request, Midspan's participant receives 17 to 19
  images. With a limit of 4 MiB, the default on Linux 6.18, it receives all of them, and also 90 images of 3 MB at
  30 Hz.
- The limit of send buffers does not matter, because sending waits for room in them. IP fragments were not lost either
  (``net.ipv4.ipfrag_high_thresh`` of 4 MiB, the kernel's default).
"""

from __future__ import annotations

import logging
import time
from contextlib import suppress
from pathlib import Path

from bridge.adapters.ros2.graph.neighbors import udp_sockets
from bridge.concurrency import DelayedCalls

_log = logging.getLogger(__name__)

WANTED = 4 * 1024 * 1024
"""Size in bytes that Midspan requests for each socket."""

LIMIT, DEFAULT = "net.core.rmem_max", "net.core.rmem_default"
"""The kernel's settings in bytes: the largest buffer that a program may request, and that of other programs."""

CURE = (
    f"write {LIMIT}={WANTED} to /etc/sysctl.d/90-ros2.conf, also {DEFAULT}={WANTED} for ROS 2 programs with Fast DDS's"
    " default settings; run 'sudo sysctl --system', and restart the daemon and these programs"
)

PERIOD = 5.0
"""Seconds between two checks, each of which takes 0.1 ms; if there were drops, 2 ms with 500 open files."""

_LOG_SECONDS = 60.0
_SHOWN_SECONDS = 600.0
"""Seconds for which the warning remains after the last drop."""

_PROC = Path("/proc")


def setting(name: str, proc: Path = _PROC) -> int | None:
    """Return a setting of the kernel; None if it is not visible, as in a container on an older kernel."""
    try:
        return int((proc / "sys" / name.replace(".", "/")).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def too_small(proc: Path = _PROC) -> str:
    """Return a text if the kernel's limit is smaller than what Midspan requests, else ""."""
    limit = setting(LIMIT, proc)
    return f"{LIMIT} is {limit}, less than {WANTED}" if limit is not None and limit < WANTED else ""


class DropWatch:
    """Counts the datagrams that the kernel has dropped at this process's UDP sockets, and logs them once per minute."""

    def __init__(self, later: DelayedCalls, proc: Path = _PROC) -> None:
        self._proc = proc
        self._by_socket: dict[str, int] = {}
        self._total = self._logged = 0
        self._last = self._log_from = float("-inf")
        later.every(PERIOD, self.check)

    @property
    def text(self) -> str:
        """The number of dropped datagrams with its cure; "" if none was dropped in the last ten minutes."""
        if time.monotonic() - self._last > _SHOWN_SECONDS:
            return ""
        seen = (
            f"the kernel dropped {self._total} UDP datagrams for the ROS 2 side because its receive buffers were full:"
            " large best-effort messages are lost"
        )
        limit = too_small(self._proc)
        cure = f"{limit}; {CURE}" if limit else "send fewer or smaller messages, or reduce the load of this machine"
        return f"{seen}; {cure}"

    def check(self) -> None:
        """Count the drops since the last check."""
        before, self._by_socket = self._by_socket, _drops(self._proc)
        new = sum(max(drops - before.get(inode, 0), 0) for inode, drops in self._by_socket.items())
        now = time.monotonic()
        if new:
            self._total, self._last = self._total + new, now
        if self._total > self._logged and now >= self._log_from:
            self._logged, self._log_from = self._total, now + _LOG_SECONDS
            _log.warning("%s", self.text)


def _drops(proc: Path) -> dict[str, int]:
    """Return the drops at each UDP socket of this process that has any, by inode."""
    listed = [*(udp_sockets(proc) or ()), *(udp_sockets(proc, "udp6") or ())]
    drops = {socket.inode: socket.drops for socket in listed if socket.drops}
    if not drops:
        return {}
    own = _own_sockets(proc)
    return {inode: count for inode, count in drops.items() if inode in own}


def _own_sockets(proc: Path) -> set[str]:
    """Return the inodes of this process's sockets (proc_pid_fd(5))."""
    targets = set[str]()
    with suppress(OSError):
        for descriptor in (proc / "self/fd").iterdir():
            with suppress(OSError):  # closed meanwhile
                targets.add(str(descriptor.readlink()))
    return {target[len("socket:[") : -1] for target in targets if target.startswith("socket:[")}
