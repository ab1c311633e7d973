"""Resources of this process: file descriptors, space in the state folder, and memory that it returns to the system."""

from __future__ import annotations

import ctypes
import errno
import logging
import os
import sys
import time
from pathlib import Path

logger = logging.getLogger("midspan.daemon")

FULL = 0.8
"""A warning is reported if a larger share of the descriptors is in use."""

RAISE = "raise the limit of open files: LimitNOFILE= in the systemd unit, or 'ulimit -n 65536' before midspan run"
"""How to fix a shortage of file descriptors."""

OUT = frozenset({errno.EMFILE, errno.ENFILE})
"""Errors of the system if this process or the machine has no descriptor left."""


LEAST_ROOM = 1 << 20
"""Free bytes below which a disk counts as full; Midspan's state is far smaller."""

_CURE = "make it writable, or set 'state' in the configuration to a folder that is"


def warnings(folder: Path) -> list[str]:
    """Return the current shortages, each with how to fix it."""
    return [text for text in (descriptors(), folder_trouble(folder)) if text]


def has_descriptor() -> bool:
    """Return whether this process can open one more file."""
    try:
        os.close(os.open(os.devnull, os.O_RDONLY))
    except OSError as err:
        return err.errno not in OUT
    return True


def folder_trouble(folder: Path) -> str:
    """Return why the state folder is not writable and how to fix that; "" if it is writable."""
    if sys.platform == "win32":
        return ""
    try:
        room = os.statvfs(folder)
    except OSError as err:
        return f"the state folder {folder}: {err.strerror}; {_CURE}"
    if not os.access(folder, os.W_OK | os.X_OK):
        why = os.strerror(errno.EROFS) if room.f_flag & os.ST_RDONLY else "not writable for this user"
        return f"the state folder {folder}: {why}; {_CURE}"
    free = room.f_bavail * room.f_frsize
    if room.f_blocks and free < LEAST_ROOM:
        return f"the state folder {folder} has {free // 1024} kB left; free space on that disk"
    return ""


def descriptors() -> str:
    """Return a warning that nearly all descriptors are in use and how to fix that; "" otherwise."""
    if sys.platform == "win32":
        return ""
    import resource

    soft, _hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        # Linux since 6.2 reports the number; elsewhere count the (possibly many) entries without building paths
        used = Path("/dev/fd").stat().st_size if sys.platform == "linux" else 0
        used = used or len(os.listdir("/dev/fd"))  # noqa: PTH208
    except OSError as err:
        if err.errno not in OUT:
            return ""
        used = soft
    if soft == resource.RLIM_INFINITY or used < FULL * soft:
        return ""
    return f"{used} of {soft} file descriptors are in use; without one, new topics and programs are refused; {RAISE}"


WANTED_FILES = 1 << 16
"""Enough for all connections, each of which needs a descriptor. The limit is not raised to an infinite hard limit,
because some programs loop over all possible descriptors."""

_MACOS_FILES = 10240
"""`OPEN_MAX` of macOS, which may refuse a higher limit even if the hard limit is infinite (setrlimit(2) of macOS)."""


def raise_open_files() -> int:
    """Raise the soft limit of open files to the hard limit, at most `WANTED_FILES`; return the limit, 0 if unknown."""
    if sys.platform == "win32":
        return 0
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = WANTED_FILES if hard == resource.RLIM_INFINITY else min(hard, WANTED_FILES)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return soft
    reason: Exception | None = None
    for limit in (wanted, min(wanted, _MACOS_FILES)):
        if limit > soft:
            try:
                resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
            except (OSError, ValueError) as err:
                reason = reason or err
            else:
                return limit
    logger.warning("the limit of open files remains at %d: %s", soft, reason)
    return soft


LARGE = 4 * 1024 * 1024
"""Minimum size in bytes of a message that counts as large."""

_IDLE_SECONDS = 10.0
"""Seconds without large messages after which memory is returned. This is longer than the time for which a YARP port
keeps a message's buffer for the next message (`yarp_compat.ports.port`)."""


class LargeMessages:
    """Returns memory to the system after some time without large messages. Thread-safe.

    glibc keeps freed memory for reuse, even more in a bridge worker (`bridge.adapters.memory`): after a worker had
    received a message of 181 MB, it had 217 MB, of which it used 35 MB.
    """

    def __init__(self) -> None:
        self._last: float | None = None

    def passed(self, size: int) -> None:
        """Note a message of ``size`` bytes."""
        if size >= LARGE:
            self._last = time.monotonic()

    def trim(self) -> bool:
        """Return free memory to the system if that is due; return whether it was due. Takes 10 ms if much is free."""
        last = self._last
        if last is None or time.monotonic() - last < _IDLE_SECONDS:
            return False
        self._last = None
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
        if trim is not None:
            trim(0)
        return True


LARGE_MESSAGES = LargeMessages()
"""The instance of this process."""
