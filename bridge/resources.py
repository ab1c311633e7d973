"""What this process may still use: file descriptors, space in the state folder, and memory given back to the system."""

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
"""Share of the descriptors in use from which it is told."""

RAISE = "raise the limit of open files: LimitNOFILE= in the systemd unit, or 'ulimit -n 65536' before midspan run"
"""The cure."""

OUT = frozenset({errno.EMFILE, errno.ENFILE})
"""What the system says when no descriptor is left, for this process or for the machine."""


LEAST_ROOM = 1 << 20
"""Bytes; what Midspan keeps is far less, and what shares the disk with it fills it by more."""

_CURE = "make it writable, or set 'state' in the configuration to a folder that is"


def warnings(folder: Path) -> list[str]:
    """What is short, each with its cure."""
    return [text for text in (descriptors(), folder_trouble(folder)) if text]


def has_descriptor() -> bool:
    """Whether this process can open one more file."""
    try:
        os.close(os.open(os.devnull, os.O_RDONLY))
    except OSError as err:
        return err.errno not in OUT
    return True


def folder_trouble(folder: Path) -> str:
    """Why nothing can be written into the state folder, with what helps; "" where all is well."""
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
        return f"the state folder {folder} has {free // 1024} kB of room left; make room on that disk"
    return ""


def descriptors() -> str:
    """How many descriptors are in use where that is nearly all, with what helps; "" where there is room."""
    if sys.platform == "win32":
        return ""
    import resource

    soft, _hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        # Linux tells the number since 6.2, elsewhere they are counted: thousands, and no path is wanted
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
"""More than enough: rospy takes about two descriptors for a subscribed topic. Some programs loop over all possible
descriptors, so an "infinite" hard limit is not taken over as it is."""


def raise_open_files() -> int:
    """Raise the soft limit of open files to the hard one, at most `WANTED_FILES`; what is in force, 0 unknown."""
    if sys.platform == "win32":
        return 0
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = WANTED_FILES if hard == resource.RLIM_INFINITY else min(hard, WANTED_FILES)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return soft
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    except (OSError, ValueError) as err:
        logger.warning("the limit of open files stays at %d: %s", soft, err)
        return soft
    return wanted


LARGE = 4 * 1024 * 1024
"""Bytes of a message from which it is worth while."""

_IDLE_SECONDS = 10.0
"""Longer than ports keep the memory of a message for the next (`yarp_compat.ports.port`)."""


class LargeMessages:
    """Gives memory back to the system when no large message passed for a while; from any thread.

    glibc keeps what was freed for the next one, in a bridge worker more of it (`bridge.adapters.memory`): after one of
    181 MB a worker that heard it had 217 MB, of which it used 35.
    """

    def __init__(self) -> None:
        self._last: float | None = None

    def passed(self, size: int) -> None:
        """A message of so many bytes passed."""
        if size >= LARGE:
            self._last = time.monotonic()

    def look(self) -> bool:
        """Give back what is free, where it is time for that; whether it was. It takes 10 ms where there is much."""
        last = self._last
        if last is None or time.monotonic() - last < _IDLE_SECONDS:
            return False
        self._last = None
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
        if trim is not None:
            trim(0)
        return True


LARGE_MESSAGES = LargeMessages()
"""The process's own."""
