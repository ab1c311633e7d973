"""LTTng in a ros2 worker on a machine whose shared memory is full.

rclpy's libraries load LTTng-UST, whose threads read a page of ``/dev/shm/lttng-ust-wait-<version>`` every 5 s. Without
room for that page the process ends by SIGBUS (observed with the wheels' version 6). If LTTng cannot open the file, it
merely does not trace. A symbolic link in place of the file has that effect, and needs no room.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from bridge.hub.shared_memory import FOLDER

_VERSIONS = range(5, 13)
_ROOM = 64 << 10
_TARGET = Path("no-room-for-tracing")


def allow_tracing_if_room(folder: Path = FOLDER) -> None:
    """Switch LTTng off for this process if the folder is full; call it before rclpy's libraries load.

    The links are removed at the process's exit, or by the next worker, if there is room then. Raises `RuntimeError` if
    LTTng's file has no page and cannot be removed.
    """
    if sys.platform != "linux":
        return
    files = list(_files(folder))
    if not _is_full(folder):
        _remove(files)
        return
    atexit.register(_remove_if_room, folder, files)
    for file in files:
        _replace(file)


def _is_full(folder: Path) -> bool:
    try:
        room = os.statvfs(folder)
    except OSError:
        return False
    return bool(room.f_blocks) and room.f_bavail * room.f_frsize < _ROOM


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files that LTTng may open: for the machine's tracing daemon, and for this user's."""
    for version in _VERSIONS:
        for owner in ("", f"-{os.getuid()}"):
            yield folder / f"lttng-ust-wait-{version}{owner}"


def _replace(file: Path) -> None:
    """Replace a file by a link, unless its page is allocated."""
    if _is_link(file):
        return
    try:
        if file.exists() and file.stat().st_blocks:
            return
        file.unlink(missing_ok=True)  # of a process that ended by SIGBUS
        file.symlink_to(_TARGET)
    except OSError as err:
        if file.exists():
            raise RuntimeError(
                f"{file.parent} is full, and {file.name} cannot be removed ({err.strerror}): LTTng, which rclpy loads,"
                " would end this process by SIGBUS; make room there"
            ) from None


def _is_link(file: Path) -> bool:
    return file.is_symlink() and file.readlink() == _TARGET


def _remove_if_room(folder: Path, files: Sequence[Path]) -> None:
    """Remove the links. Without room they stay: LTTng's threads still run, and would end this process by SIGBUS."""
    if not _is_full(folder):
        _remove(files)


def _remove(files: Sequence[Path]) -> None:
    for file in files:
        with contextlib.suppress(OSError):
            if _is_link(file):
                file.unlink()
