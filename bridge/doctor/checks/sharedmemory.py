"""Shared memory: other users' Fast DDS, too little space, leftovers of dead processes, lost ports.

Fast DDS 2 creates segments ``fastrtps_<16 hex>`` and ports ``fastrtps_port<n>``, Fast DDS 3 ``fastdds_...``; neither
uses files of the other. Their users hold a lock (flock) on the file ``<name>_el``. zenoh 1.10 creates
``<number>.zenoh`` and locks the file itself. On Linux ``/proc/locks`` lists the locked files, including those of other
users (verified for both).
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bridge.adapters.ros2 import own_profile
from bridge.adapters.ros2.graph.ports import lost_ports
from bridge.doctor.check import Finding, Findings, fail, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.hub.shared_memory import NAME, is_locked

SMALL_BYTES = 128 * 1024 * 1024
"""Size in bytes below which large messages may not fit.

Fast DDS needs half a megabyte for a default participant; Midspan uses an eighth of the free space, up to 32 MiB."""
FULL_BYTES = 8 * 1024 * 1024
LITTER_BYTES = 16 * 1024 * 1024
LITTER_FILES = 20
_LONGEST_NAME = 80

_CURE_SIZE = "give it more: docker run --shm-size=1g, or mount -o remount,size=1g /dev/shm"


def check_users(context: CheckContext) -> Findings:
    """Check for other users, to whom Fast DDS's shared memory delivers nothing although the graph looks complete."""
    if context.config.ros2.enabled is False or not context.shm.is_dir():
        return skip("ROS 2 over shared memory is not used here")
    mine = {_daemons_user(context)}
    living = [f for f in shared_files(context.shm, context.proc) if f.fast_dds and f.held]
    used = {f.maker for f in living if f.uid in mine}  # empty without a running worker; then any maker counts
    others = {f.uid for f in living if not used or f.maker in used} - mine
    if not others:
        return ok("one user only")
    names = ", ".join(sorted(_user_name(uid) for uid in others))
    seen = (
        f"ROS 2 programs of users other than {_user_name(next(iter(mine)))} share {context.shm}: {names}; Fast DDS's"
        " shared memory silently delivers nothing between users"
    )
    cure = "run them as the same user, or with FASTDDS_BUILTIN_TRANSPORTS=UDPv4"
    transport = context.config.ros2.transport
    if transport == "shared_memory":
        return fail(seen, f"set ros2.transport to auto or udp; or {cure}")
    if transport == "udp":
        return ok(f"other users' ROS 2 programs are here ({names}); ros2.transport is udp, which reaches them")
    return warn(seen, f"Midspan (ros2.transport: auto) switches to UDP by itself; for the other programs: {cure}")


def check_size(context: CheckContext) -> Findings:
    """Check the size and free space of the shared memory, and that the segment of ``ros2.profile`` fits into it."""
    if not context.shm.is_dir():
        return skip(f"no {context.shm} here")
    ros2 = context.config.ros2
    size = _check_size(context)
    if ros2.profile is None or ros2.enabled is False or not (trouble := own_profile.trouble(ros2.profile, context.shm)):
        return size
    seen, _, cure = trouble.partition(": ")
    return [size, warn(seen, cure)]


def _check_size(context: CheckContext) -> Finding:
    stat = os.statvfs(context.shm)
    total, free = stat.f_blocks * stat.f_frsize, stat.f_bavail * stat.f_frsize
    text = f"{context.shm}: {free / 1e6:.0f} MB free of {total / 1e6:.0f} MB"
    if free < FULL_BYTES:
        return fail(f"{text}; large messages use slower transports, and programs fail to start", _CURE_SIZE)
    if total < SMALL_BYTES:
        return warn(f"{text}; large ROS 2 messages are fragmented or use UDP", _CURE_SIZE)
    return ok(text)


def check_litter(context: CheckContext) -> Findings:
    """Check for segments of killed processes."""
    if not context.shm.is_dir():
        return skip(f"no {context.shm} here")
    left = [f for f in shared_files(context.shm, context.proc) if f.held is False and not f.young and not f.port]
    size = sum(file.size for file in left)
    if size < LITTER_BYTES and len(left) < LITTER_FILES:
        return ok(f"{len(left)} files of dead processes, {size / 1e6:.1f} MB")
    dds, zenoh = [f for f in left if f.fast_dds], [f for f in left if not f.fast_dds]
    cures = []
    if dds:
        cures.append("'fastdds shm clean', or a restart of Midspan's ros2 worker, removes Fast DDS's files")
    if zenoh:
        cures.append(f"rm {' '.join(str(f.path) for f in zenoh[:3])}{' ...' if len(zenoh) > 3 else ''}")
    seen = f"{len(left)} files ({size / 1e6:.0f} MB) in {context.shm} belong to processes that were killed"
    return warn(seen, "; ".join(cures))


def check_ports(context: CheckContext) -> Findings:
    """Check for ROS 2 programs whose port was removed: they receive nothing over shared memory."""
    if not context.shm.is_dir():
        return skip(f"no {context.shm} here")
    mute = [_program(process) for process in sorted(context.proc.glob("[0-9]*")) if lost_ports(process, context.shm)]
    if not mute:
        return ok("all ROS 2 programs listen at their ports")
    seen = (
        "other ROS 2 programs removed the shared memory of a program while it was not running, so it receives nothing"
        f" over shared memory: {', '.join(mute)}"
    )
    return warn(seen, "restart it, or resume it if it is suspended")


def _program(process: Path) -> str:
    """Return the command line and the id of a process in the process table."""
    words = list[str]()
    with contextlib.suppress(OSError):
        words = (process / "cmdline").read_text(encoding="utf-8", errors="replace").split("\0")
    return f"{' '.join(words).strip()[:_LONGEST_NAME] or 'a program'} (process {process.name})"


def _daemons_user(context: CheckContext) -> int:
    """Return the user of the running ros2 worker, else the current user, who would start it."""
    for document in context.hub.of_side("ros2"):
        process = context.process(document)
        if process is not None:
            return process.uids().effective
    return os.geteuid()


def _user_name(uid: int) -> str:
    import pwd

    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"


_SEGMENT = re.compile(r"(?:fastrtps|fastdds)_[0-9a-f]{16}")
_PORT = re.compile(r"(?:fastrtps|fastdds)_port\d+")
_LOCK = re.compile(r"FLOCK .* ([0-9a-f]+):([0-9a-f]+):(\d+) ")
_YOUNG_SECONDS = 10.0
"""A file younger than this may not be locked yet."""

_Lock = tuple[int, int, int]
"""Device (major, minor) and inode of a locked file."""


@dataclass(frozen=True, slots=True)
class SharedFile:
    """A file; ``held``: whether a living process uses it, None if unknown; ``young``: whether it was just created."""

    path: Path
    uid: int
    size: int
    held: bool | None
    young: bool

    @property
    def fast_dds(self) -> bool:
        """Whether the file belongs to Fast DDS."""
        return not NAME.fullmatch(self.path.name)

    @property
    def maker(self) -> str:
        """``fastrtps`` or ``fastdds``: Fast DDS 2 or 3."""
        return self.path.name.partition("_")[0]

    @property
    def port(self) -> bool:
        """Whether the file is a port of Fast DDS, which reuses a dead port when the port's number is used again."""
        return _PORT.fullmatch(self.path.name) is not None


def shared_files(folder: Path, proc: Path) -> list[SharedFile]:
    """Return the segments and ports of Fast DDS and the pools of zenoh in ``/dev/shm``."""
    locks = _locks(proc)
    files: list[SharedFile] = []
    for path in sorted(_entries(folder)):
        with contextlib.suppress(OSError):
            stat = path.stat()
            lock = path if NAME.fullmatch(path.name) else path.with_name(f"{path.name}_el")
            young = time.time() - stat.st_mtime < _YOUNG_SECONDS
            files.append(SharedFile(path, stat.st_uid, stat.st_blocks * 512, _is_held(lock, locks), young))
    return files


def _entries(folder: Path) -> Iterator[Path]:
    with contextlib.suppress(OSError):
        yield from (p for p in folder.iterdir() if any(k.fullmatch(p.name) for k in (_SEGMENT, _PORT, NAME)))


def _locks(proc: Path) -> set[_Lock]:
    try:
        text = (proc / "locks").read_text(encoding="utf-8")
    except OSError:
        return set()
    return {(int(m[1], 16), int(m[2], 16), int(m[3])) for m in _LOCK.finditer(text)}


def _is_held(lock: Path, locks: set[_Lock]) -> bool | None:
    try:
        stat = lock.stat()
    except FileNotFoundError:
        return False
    if (os.major(stat.st_dev), os.minor(stat.st_dev), stat.st_ino) in locks:
        return True
    # in a container the list lacks the locks of other containers: try to lock
    try:
        return is_locked(lock)
    except OSError:
        return None
