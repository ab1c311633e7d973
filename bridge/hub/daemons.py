"""The identity of a daemon in its control-plane answers, which distinguishes two daemons with the same name."""

from __future__ import annotations

import contextlib
import socket
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bridge.config.model import Config
from bridge.state_file import state_folder

_BOOT = Path("/proc/sys/kernel/random/boot_id")
_MAX_TEXT = 200


@dataclass(frozen=True, slots=True)
class DaemonIdentity:
    """The identity of a daemon, which its workers and its router include in their answers.

    Attributes:
        instance: identity of its state folder, which only one daemon of this name can use.
        machine: its host name.
        folder: path of its state folder.
    """

    instance: str
    machine: str
    folder: str

    @property
    def place(self) -> str:
        """The state folder and the machine, as text."""
        return f"state folder {self.folder} on {self.machine}"

    def as_dict(self) -> dict[str, str]:
        """Return the identity as a JSON object for an answer."""
        return asdict(self)


def identity_of(config: Config) -> DaemonIdentity | None:
    """Return the identity of a configuration's daemon, None if its state folder does not exist or is unreadable."""
    folder = state_folder(config).absolute()
    boot = ""
    with contextlib.suppress(OSError):
        boot = _BOOT.read_text(encoding="utf-8").strip()
    try:
        status = folder.stat()
    except OSError:
        return None
    machine = socket.gethostname()
    return DaemonIdentity(f"{boot or machine}-{status.st_dev}-{status.st_ino}", machine, str(folder)[:_MAX_TEXT])


def read_identity(value: Any) -> DaemonIdentity | None:
    """Return the identity in an answer; None if it is missing (earlier releases send none) or invalid."""
    if not isinstance(value, dict):
        return None
    texts = [text[:_MAX_TEXT] for text in map(value.get, ("instance", "machine", "folder")) if isinstance(text, str)]
    return DaemonIdentity(*texts) if len(texts) == 3 else None
