"""Where the daemon and its workers keep their state."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from bridge.config.model import Config

LEAST_ROOM = 1 << 20
"""Bytes; what Midspan keeps is far less, and what shares the disk with it fills it by more."""

_CURE = "make it writable, or set 'state' in the configuration to a folder that is"


def state_folder(config: Config, environ: Mapping[str, str] = os.environ) -> Path:
    """Where the daemon and its workers keep their state; see ``state`` in the configuration."""
    if config.state is not None:
        return config.state
    if environ.get("STATE_DIRECTORY"):  # systemd's StateDirectory=; several are separated by colons
        return Path(environ["STATE_DIRECTORY"].split(":")[0])
    home = environ.get("XDG_STATE_HOME") or Path(environ.get("HOME") or Path.home()) / ".local" / "state"
    return Path(home) / "midspan"


def worker_folder(config: Config, environ: Mapping[str, str] = os.environ) -> Path:
    """Where the workers of this daemon keep what they must know again; several daemons may share a state folder."""
    return state_folder(config, environ) / config.name


def trouble(folder: Path) -> str:
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
