"""The daemons' systemd units: the unit of a configuration, and the units in use on this machine."""

from __future__ import annotations

import sys
from pathlib import Path

from bridge.state_file import SERVICE_STATE

SETTINGS = Path("/etc/midspan")
STATE = SERVICE_STATE

_MAIN = "midspan"
_LINKS = ("etc/systemd/system/*.wants/midspan*.service", "run/systemd/units/invocation:midspan*.service")
"""Links of the units that are enabled, and of those that are active."""


def unit_of(file: Path | str | None) -> str:
    """Return the unit that runs a file: ``midspan@robot2`` for /etc/midspan/robot2.yaml, ``midspan`` for any other."""
    path = SETTINGS if file is None else Path(file).absolute()
    instance = path.parent == SETTINGS and path.suffix == ".yaml" and path.stem != _MAIN
    return f"{_MAIN}@{path.stem}" if instance else _MAIN


def start_hint(unit: str) -> str:
    """Return the commands that start the daemon of a unit and show its log."""
    if sys.platform != "linux":
        return "start the daemon: 'midspan run'"
    command = f"systemctl start {unit}"
    start = f"'midspan run' (or '{command}')" if unit == _MAIN else f"'{command}'"
    return f"start the daemon: {start}; 'journalctl -u {unit}' shows why it exited"


def log_hint(unit: str) -> str:
    """Return how to see the log of a unit's daemon."""
    return f"see its log: journalctl -u {unit}" if sys.platform == "linux" else "see the log of 'midspan run'"


def units_in_use(root: Path = Path("/")) -> dict[str, Path]:
    """Return the daemons' units that are enabled or active, with the configuration of each."""
    names = {link.stem.removeprefix("invocation:") for pattern in _LINKS for link in root.glob(pattern)}
    files: dict[str, Path] = {}
    for name in sorted(names):
        unit, _, instance = name.partition("@")
        if unit == _MAIN:
            files[name] = root / SETTINGS.relative_to("/") / f"{instance or _MAIN}.yaml"
    return files
