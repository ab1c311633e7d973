"""The files of a machine's identity, without what reads certificates: the router's process does not import that."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from bridge.hub.errors import HubConfigError


@dataclass(frozen=True, slots=True)
class KeyFiles:
    """The files of a machine's identity."""

    ca: Path
    certificate: Path
    key: Path

    def check(self) -> None:
        """Raise `HubConfigError` if one is missing or cannot be read."""
        for file in (self.ca, self.certificate, self.key):
            if not file.exists():
                raise HubConfigError(
                    f"there is no {file}; 'midspan keys make' makes it, and prints which files to copy here"
                )
            if not os.access(file, os.R_OK):
                raise HubConfigError(f"{file} cannot be read by this process's user; give it to that user (chown)")
