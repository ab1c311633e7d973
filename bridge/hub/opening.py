"""Opens zenoh sessions, without shared memory if this machine has no room for it.

zenoh 1.10 locks its shared memory into RAM. A session with shared memory does not open if ``/dev/shm`` is full. If a
session's pool finds no room later, zenoh continues on the network link and never tries again: the pool's file keeps its
full size, but has almost no memory, which `check_pool` reports. But without its book-keeping, which it creates
for the first large message, each such message raises a Rust panic. So `open_session` creates that first, once in each
process. A receiver that may not lock a sender's pool (``RLIMIT_MEMLOCK``) loses messages silently, and must not offer
shared memory either (all observed with 1.10.2).
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import json
import logging
import mmap
import os
import re
import sys
import threading
import time
from pathlib import Path

import zenoh

from bridge.hub.errors import zenoh_reason
from bridge.hub.shared_memory import FOLDER
from bridge.hub.zenoh_config import POOL, without_shared_memory

_log = logging.getLogger(__name__)

_SWITCH = "transport/shared_memory/enabled"
_POOL_SIZE = "transport/shared_memory/transport_optimization/pool_size"

_BLOCK = 512
_BOOKS = 2 << 20
"""Bytes for zenoh's book-keeping in each process (1.3 MB), and for the small files of a session."""

_CHECK_SECONDS = 10.0
"""Time between two checks of the pool; two must agree, as zenoh may be creating it during one."""

_lock = threading.Lock()
_books = _noted = False
_trouble = ""
_pool = POOL
_check_due = 0.0
_empty_pool: Path | None = None


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session; switch shared memory off in ``config`` if it is enabled but unusable, and log the reason.

    Raises `zenoh.ZError` if the session does not open without shared memory either.
    """
    if not json.loads(config.get_json(_SWITCH)):
        return zenoh.open(config)
    global _pool
    _pool = int(json.loads(config.get_json(_POOL_SIZE)))
    size = _pool + _BOOKS
    reason = room_trouble(size)
    if not reason and (lock := lock_trouble(size)):
        _note(lock, logging.INFO)  # the default of many systems, and no trouble of this one
        return zenoh.open(without_shared_memory(config))
    reason = reason or _books_trouble()
    if not reason:
        try:
            return zenoh.open(config)
        except zenoh.ZError as err:
            if "shm" not in str(err).lower():
                raise
            reason = zenoh_reason(err)
    _note(reason, logging.WARNING)
    return zenoh.open(without_shared_memory(config))


def trouble() -> str:
    """Return why sessions of this process have no room for their shared memory, and the cure; "" if they have."""
    return _trouble


def check_pool() -> None:
    """Report a pool for which zenoh found no room when this process sent its first large message."""
    global _check_due, _empty_pool
    now = time.monotonic()
    with _lock:
        if _trouble or not _books or now < _check_due:
            return
        _check_due = now + _CHECK_SECONDS
        before, _empty_pool = _empty_pool, next(filter(_is_empty, _mapped_files()), None)
        confirmed = _empty_pool is not None and _empty_pool == before
    if confirmed:
        reason = f"{FOLDER} had no room for the {_pool / 1e6:.0f} MB that a session needs; remove files or enlarge it"
        _note(reason, logging.WARNING)


def _is_empty(file: Path) -> bool:
    """Whether a file has the size of a pool, but not the memory."""
    try:
        status = file.stat()
    except OSError:
        return False
    return status.st_size >= _pool and status.st_blocks * _BLOCK < _pool


def _note(reason: str, level: int) -> None:
    """Log the reason once, and keep it as `trouble` if the level is that of a warning."""
    global _noted, _trouble
    text = f"large messages go over the network link instead of shared memory: {reason}; then restart this worker"
    with _lock:
        known, _noted = _noted, True
        if level >= logging.WARNING:
            _trouble = text
    if not known:
        _log.log(level, "%s", text)


def room_trouble(size: int, folder: Path = FOLDER) -> str:
    """Return why the system's shared memory has no room for ``size`` bytes, with the cure, or ""."""
    if sys.platform != "linux":  # other systems do not expose it as a folder
        return ""
    try:
        room = os.statvfs(folder)
    except OSError as err:
        return f"{folder}: {err.strerror}; mount it"
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"{folder} is not writable for this user; its mode should be 1777"
    free = room.f_bavail * room.f_frsize
    if room.f_blocks and free < size:
        return f"{folder} has less room than the {size / 1e6:.0f} MB that a session needs; remove files or enlarge it"
    return ""


def lock_trouble(size: int) -> str:
    """Return why this process may not lock ``size`` bytes into RAM, with the cure, or ""."""
    if sys.platform != "linux":
        return ""
    import resource

    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit == resource.RLIM_INFINITY or limit >= 16 * size:
        return ""
    libc = ctypes.CDLL(None, use_errno=True)
    with contextlib.closing(mmap.mmap(-1, size)) as memory:
        view = ctypes.c_char.from_buffer(memory)
        refused = libc.mlock(ctypes.byref(view), ctypes.c_size_t(size))
        del view
    if not refused:
        return ""
    cure = "set LimitMEMLOCK=infinity in the systemd unit, or 'ulimit -l unlimited'"
    return f"this user may lock {limit / 1e6:.1f} MB of memory, and a session needs {size / 1e6:.0f} MB; {cure}"


def _books_trouble() -> str:
    """Create zenoh's book-keeping in this process; returns the reason if that fails."""
    global _books
    with _lock:
        if _books or sys.platform != "linux":
            return ""
        try:
            zenoh.shm.ShmProvider.default_backend(4096).alloc(64)
        except BaseException as err:
            if not isinstance(err, zenoh.ZError) and type(err).__name__ != "PanicException":  # Rust's, no Exception
                raise
            return zenoh_reason(Exception(str(err)))
        _books = True
        atexit.register(_remove, _mapped_files())
    return ""


def _mapped_files() -> list[Path]:
    """Return zenoh's files of shared memory that this process has mapped."""
    try:
        maps = Path("/proc/self/maps").read_text()
    except OSError:
        return []
    return sorted({Path(path) for path in re.findall(rf"({re.escape(str(FOLDER))}/\d+\.zenoh)$", maps, re.MULTILINE)})


def _remove(files: list[Path]) -> None:
    """Remove the book-keeping, which zenoh leaves at the end of a Python process."""
    for file in files:
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)
