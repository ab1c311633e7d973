"""The state folder: its path, the names of its files, and atomic writes."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import socket
from collections.abc import Mapping
from pathlib import Path

from bridge.config.model import DAEMON_NAME, Config
from yarp_compat.file_names import escaped

SERVICE_STATE = Path("/var/lib/midspan")
"""The state folder of all systemd units (``StateDirectory=midspan``)."""


def state_folder(config: Config, environ: Mapping[str, str] = os.environ) -> Path:
    """Return the folder for the state of the daemon and its workers; see ``state`` in the configuration."""
    if config.state is not None:
        return config.state
    if environ.get("STATE_DIRECTORY"):  # from systemd's StateDirectory=, with colons between several folders
        return Path(environ["STATE_DIRECTORY"].split(":")[0])
    home = environ.get("XDG_STATE_HOME") or Path(environ.get("HOME") or Path.home()) / ".local" / "state"
    return Path(home) / "midspan"


def worker_folder(config: Config, environ: Mapping[str, str] = os.environ) -> Path:
    """Return the folder of this daemon's workers within the state folder, which several daemons may share."""
    return state_folder(config, environ) / escaped(config.name)


def lane_folder(config: Config, environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return the folder of the lanes of this daemon's workers; None if the configuration disables lanes."""
    return worker_folder(config, environ) / "lane" if config.hub.lane else None


# sun_path of sockaddr_un has 108 bytes including its NUL on Linux, 104 on macOS
_MAX_SOCKET_PATH = 103


_NAME_FILE = ".name"  # no daemon's name begins with a dot


def named(config: Config, environ: Mapping[str, str] = os.environ, *others: Path) -> Config:
    """Return the configuration with the daemon's name from the state folder, if its file does not set ``name``.

    The paths of stored files contain the daemon's name, so the files would be lost if that changed with the machine's
    name.
    ``others`` are further folders to search if the configuration does not set ``state`` either.
    """
    if "name" in config.model_fields_set:
        return config
    folders = [state_folder(config, environ), *(others if config.state is None else ())]
    names = [name for name in map(_stored_name, folders) if name]
    return config.model_copy(update={"name": names[0]}) if names else config


def _stored_name(folder: Path) -> str:
    """Return the daemon's name that a state folder contains, "" if it contains no valid name."""
    try:
        name = (folder / _NAME_FILE).read_text(encoding="utf-8").strip()
    except (OSError, ValueError):
        return ""
    return name if re.fullmatch(DAEMON_NAME, name) else ""


def with_state(config: Config, environ: Mapping[str, str] = os.environ) -> Config:
    """Return the configuration with state folder and name filled in; create the folder, accessible only to its owner.

    Raises `RuntimeError` if the folder cannot be created or written to.
    """
    config = named(config, environ)
    folder = state_folder(config, environ).absolute()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(13, "not writable for this user")
        # on systems without user ids, such as Windows, the folder inherits the permissions of its parent
        if hasattr(os, "geteuid") and folder.stat().st_uid == os.geteuid():
            folder.chmod(0o700)
    except OSError as err:
        msg = f"state folder {folder}: {err.strerror}; set 'state' in the configuration to a writable folder"
        raise RuntimeError(msg) from err
    if "name" not in config.model_fields_set:
        keep(folder / _NAME_FILE, f"{config.name}\n", "the daemon's name will change if the machine's does")
    return config.model_copy(update={"state": folder, "name": config.name})


def daemon_lock(config: Config) -> Path:
    """Return the lock file of the daemon with this name."""
    return _in_state(config, f"{config.name}.daemon.lock")


def worker_lock(config: Config, worker: str) -> Path:
    """Return the lock file of one of the daemon's workers."""
    return _in_state(config, f"{config.name}.{worker}.lock")


def worker_output(config: Config, worker: str) -> Path:
    """Return the file for the stderr of a worker that outlives its daemon."""
    return _in_state(config, f"{config.name}.{worker}.stderr")


def control_socket(config: Config, worker: str) -> Path:
    """Return the control socket of a worker that outlives its daemon.

    Raises `RuntimeError` if the path is too long for a socket.
    """
    return _socket_in_state(config, f"{config.name}.{worker}.sock")


def daemon_socket(config: Config) -> Path:
    """Return the socket on which the daemon answers requests; raises like `control_socket`."""
    return _socket_in_state(config, f"{config.name}.daemon.sock")


def _socket_in_state(config: Config, name: str) -> Path:
    path = _in_state(config, name)
    if hasattr(socket, "AF_UNIX") and len(os.fsencode(path)) > _MAX_SOCKET_PATH:
        msg = f"{path} is too long for a socket's name; set 'state' in the configuration to a shorter folder"
        raise RuntimeError(msg)
    return path


def _in_state(config: Config, name: str) -> Path:
    if config.state is None:
        msg = "the configuration's state folder is not filled in"
        raise ValueError(msg)
    return config.state / escaped(name)


_log = logging.getLogger(__name__)


def keep(file: Path, text: str, loss: str) -> bool:
    """Write a file in the state folder atomically; return whether it was written.

    ``loss`` describes the consequence of a failure, for the log.
    """
    temporary = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(file)
    except OSError as err:
        _log.warning("cannot write %s: %s; %s", file, err.strerror, loss)
        with contextlib.suppress(OSError):
            temporary.unlink()
        return False
    return True
