"""Where the daemon and its workers keep their state."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from bridge.config.model import Config


def state_folder(config: Config, environ: Mapping[str, str] = os.environ) -> Path:
    """Where the daemon and its workers keep their state; see ``state`` in the configuration."""
    if config.state is not None:
        return config.state
    if environ.get("STATE_DIRECTORY"):  # systemd's StateDirectory=; several are separated by colons
        return Path(environ["STATE_DIRECTORY"].split(":")[0])
    home = environ.get("XDG_STATE_HOME") or Path(environ.get("HOME") or Path.home()) / ".local" / "state"
    return Path(home) / "midspan"
