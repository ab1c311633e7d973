"""Where YARP keeps its files on each system, by environment variables first.

The rules are those of YARP 3.5 and later (yarp/conf/dirs.h): ``YARP_DATA_HOME`` and its kin name the
directory itself; the XDG variables (APPDATA and ALLUSERSPROFILE on Windows) name one in which ``yarp`` is looked for.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from yarp_compat.naming.config import folder


@dataclass(frozen=True)
class Directories:
    """YARP's directories.

    Attributes:
        environment: the variables that decide.
        platform: as `sys.platform` names it.
    """

    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    platform: str = sys.platform

    def data_home(self) -> Path:
        """The user's own data: contexts and robots that were edited."""
        own = {
            "win32": self._home() / "AppData" / "Roaming",
            "darwin": self._home() / "Library" / "Application Support",
        }
        default = own.get(self.platform, self._home() / ".local" / "share")
        if self.environment.get("YARP_DATA_HOME"):
            return Path(self.environment["YARP_DATA_HOME"])
        return Path(self.environment.get(self._variable("APPDATA", "XDG_DATA_HOME")) or default) / "yarp"

    def config_home(self) -> Path:
        """The user's own settings: ``yarp.conf`` and its kin."""
        return Path(folder(self.environment, self.platform))

    def data_dirs(self) -> list[Path]:
        """What is installed for everybody."""
        default = "C:\\ProgramData" if self.platform == "win32" else "/usr/local/share:/usr/share"
        return self._many("YARP_DATA_DIRS", self._variable("ALLUSERSPROFILE", "XDG_DATA_DIRS"), default, "yarp")

    def config_dirs(self) -> list[Path]:
        """What the machine's administrator set."""
        default = {"win32": "C:\\ProgramData", "darwin": "/etc:/Library/Preferences"}.get(self.platform, "/etc/xdg")
        variable = self._variable("ALLUSERSPROFILE", "XDG_CONFIG_DIRS")
        return self._many("YARP_CONFIG_DIRS", variable, default, self._config_suffix())

    def robot(self) -> str:
        """The robot's name: ``YARP_ROBOT_NAME``, or ``default``."""
        return self.environment.get("YARP_ROBOT_NAME", "default")

    def _home(self) -> Path:
        return Path(self.environment.get("USERPROFILE" if self.platform == "win32" else "HOME", ""))

    def _variable(self, windows: str, linux: str) -> str:
        # macOS has no such variable: its directories are fixed.
        return {"win32": windows, "darwin": ""}.get(self.platform, linux)

    def _config_suffix(self) -> str:
        return "yarp/config" if self.platform == "win32" else "yarp"

    def _many(self, own: str, variable: str, default: str, suffix: str) -> list[Path]:
        separator = ";" if self.platform == "win32" else ":"
        if self.environment.get(own):
            return [Path(part) for part in self.environment[own].split(separator) if part]
        return [Path(part) / suffix for part in (self.environment.get(variable) or default).split(separator) if part]
