"""Opens zenoh sessions, without shared memory if this machine lacks room for it or may not lock it into RAM.

zenoh 1.10 locks its shared memory into RAM. A session with shared memory does not open if ``/dev/shm`` is full. If a
session's pool does not fit later, zenoh continues on the network link and never tries again: the pool's file keeps its
full size, but has almost no memory, which `check_pool` reports. But if the pool exists and zenoh's book-keeping does
not fit, each large message raises a Rust panic. So `prepare_to_send` creates the book-keeping before the pool: if that
fails, the pool does not fit either. A receiver needs no room for either, but a receiver that is not allowed to lock a
sender's pool (``RLIMIT_MEMLOCK``) loses messages silently, and must not offer shared memory (all observed with 1.10.2).

The book-keeping takes 11 MB in each process that sends or receives a large message, so it is not created earlier.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import json
import logging
import mmap
import re
import sys
import threading
import time
from pathlib import Path

import zenoh

from bridge.hub.errors import zenoh_reason
from bridge.hub.freeing import keep
from bridge.hub.panics import is_panic, watched
from bridge.hub.shared_memory import FOLDER, RESTART, room_trouble
from bridge.hub.zenoh_config import POOL, without_shared_memory

_log = logging.getLogger(__name__)

_SWITCH = "transport/shared_memory/enabled"
_OPTIMIZATION = "transport/shared_memory/transport_optimization"

_BLOCK = 512
_BOOKS = 2 << 20
"""Bytes in ``/dev/shm`` for zenoh's book-keeping in each process (1.3 MB), and for a session's small files."""

_LOCK_ON_FAULT = 1  # MLOCK_ONFAULT of Linux 4.4

_SESSIONS = 16
"""Number of sending sessions whose pools a receiver must be allowed to lock, more than a daemon's workers have."""

_CHECK_SECONDS = 10.0
"""Seconds between two checks of the pool; two must agree, because zenoh may be creating the pool during one check."""

_lock = threading.Lock()
_books = _noted = False
_needs_books = sys.maxsize
"""Size in bytes of the smallest message before which the book-keeping has to be created."""
_trouble = ""
_pool = POOL
_check_due = 0.0
_empty_pool: Path | None = None


def open_session(config: zenoh.Config, *, prepares: bool = False) -> zenoh.Session:
    """Open a session; switch shared memory off in ``config`` if it is enabled but unusable, and log the reason.

    With ``prepares`` the caller promises to call `prepare_to_send` before each message that may be large. Raises
    `zenoh.ZError` if the session does not open without shared memory either.
    """
    session = watched(_open(config, prepares=prepares))
    return keep(session) if json.loads(config.get_json("mode")) == "router" else session


def _open(config: zenoh.Config, *, prepares: bool) -> zenoh.Session:
    if not json.loads(config.get_json(_SWITCH)):
        return zenoh.open(config)
    global _pool, _needs_books
    optimization = json.loads(config.get_json(_OPTIMIZATION))
    _pool = int(optimization["pool_size"])
    size = _pool + _BOOKS
    reason = room_trouble(size)
    if not reason and (lock := lock_trouble(size)):
        _note(lock, logging.INFO)  # the default on many systems, not a problem of this one
        return zenoh.open(without_shared_memory(config))
    if not reason and not prepares:
        reason = _books_trouble()
    if not reason:
        if not _books:
            _needs_books = min(_needs_books, int(optimization["message_size_threshold"]))
        try:
            return zenoh.open(config)
        except zenoh.ZError as err:
            if "shm" not in str(err).lower():
                raise
            reason = zenoh_reason(err)
    _note(reason, logging.WARNING)
    return zenoh.open(without_shared_memory(config))


def prepare_to_send(size: int) -> None:
    """Create zenoh's book-keeping if a message of ``size`` bytes is the first that needs it.

    It takes a few milliseconds, once. If it fails, the reason is logged, and zenoh uses the network link.
    """
    if size >= _needs_books and (reason := _books_trouble()):
        _note(reason, logging.WARNING)


def trouble() -> str:
    """Return why the shared memory of this process does not fit, and how to fix that; "" if it fits."""
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
    """Return whether a file has the size of a pool, but not the memory."""
    try:
        status = file.stat()
    except OSError:
        return False
    return status.st_size >= _pool and status.st_blocks * _BLOCK < _pool


def _note(reason: str, level: int) -> None:
    """Log only the first reason; store the reason for `trouble` if the level is at least a warning."""
    global _noted, _trouble
    text = f"large messages go over the network link instead of shared memory: {reason}; then {RESTART}"
    with _lock:
        known, _noted = _noted, True
        if level >= logging.WARNING:
            _trouble = text
    if not known:
        _log.log(level, "%s", text)


def lock_trouble(size: int) -> str:
    """Return why this process may not lock the pools of `_SESSIONS` sessions into RAM, and how to fix that, or "".

    ``size`` is what one of them needs, in bytes.
    """
    if sys.platform != "linux":
        return ""
    import resource

    limit, needed = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0], _SESSIONS * size
    if limit == resource.RLIM_INFINITY or limit >= needed:
        return ""
    libc, refused = ctypes.CDLL(None, use_errno=True), True
    with contextlib.suppress(OSError), contextlib.closing(mmap.mmap(-1, needed)) as memory:
        view = ctypes.c_char.from_buffer(memory)
        # on fault: the system provides no pages, which would take 20 ms for each session
        refused = bool(libc.mlock2(ctypes.byref(view), ctypes.c_size_t(needed), _LOCK_ON_FAULT))
        del view
    if not refused:
        return ""
    cure = "set LimitMEMLOCK=infinity in the systemd unit, or 'ulimit -l unlimited'"
    return (
        f"this user may lock {limit / 1e6:.1f} MB of memory, and a process that receives from {_SESSIONS} sessions"
        f" locks up to {needed / 1e6:.0f} MB; {cure}"
    )


def _books_trouble() -> str:
    """Create zenoh's book-keeping in this process unless it exists; if that fails, return the reason, else ""."""
    global _books, _needs_books
    with _lock:
        if _books or sys.platform != "linux":
            _needs_books = sys.maxsize
            return ""
        before = _mapped_files()
        try:
            zenoh.shm.ShmProvider.default_backend(4096).alloc(64)
        except BaseException as err:
            if not isinstance(err, zenoh.ZError) and not is_panic(err):
                raise
            return zenoh_reason(Exception(str(err)))
        finally:
            _needs_books = sys.maxsize
        _books = True
        atexit.register(_remove, [file for file in _mapped_files() if file not in before])
    return ""


def _mapped_files() -> list[Path]:
    """Return zenoh's shared-memory files that this process has mapped."""
    try:
        maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    except OSError:
        return []
    return sorted({Path(path) for path in re.findall(rf"({re.escape(str(FOLDER))}/\d+\.zenoh)$", maps, re.MULTILINE)})


def _remove(files: list[Path]) -> None:
    """Remove the book-keeping's files, which zenoh leaves in place when a Python process exits."""
    for file in files:
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)
