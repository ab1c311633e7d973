"""YARP's directories on each operating system (`yarp/conf/dirs.h`).

``YARP_DATA_HOME`` and similar variables (since 3.5) name YARP's own directory, even if they are empty. The XDG
variables (APPDATA, LOCALAPPDATA and ALLUSERSPROFILE on Windows) name the parent of a directory ``yarp``; macOS has no
such variables.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Directories:
    """The directories for the variables of an environment and a `sys.platform`."""

    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    platform: str = sys.platform

    def home(self) -> str:
        """Return the user's home directory."""
        return self.environment.get("USERPROFILE" if self._windows else "HOME", "")

    def temporary(self) -> str:
        """Return the directory for temporary files."""
        if self._windows:
            return self.environment.get("TEMP", f"{self.home()}\\AppData\\Local\\Temp")
        return self.environment.get("TMPDIR", "/tmp")  # noqa: S108 - YARP's default

    def data(self) -> str:
        """Return the directory of the user's data for all programs."""
        if self._windows:
            return self.environment.get("APPDATA", f"{self.home()}\\AppData\\Roaming")
        if self._mac:
            return f"{self.home()}/Library/Application Support"
        return self.environment.get("XDG_DATA_HOME", f"{self.home()}/.local/share")

    def config(self) -> str:
        """Return the directory of the user's settings for all programs."""
        if self._windows:
            return self.environment.get("APPDATA", f"{self.home()}\\AppData\\Roaming")
        if self._mac:
            return f"{self.home()}/Library/Preferences"
        return self.environment.get("XDG_CONFIG_HOME", f"{self.home()}/.config")

    def cache(self) -> str:
        """Return the directory of the user's caches for all programs."""
        if self._windows:
            return self.environment.get("LOCALAPPDATA", f"{self.home()}\\AppData\\Local")
        if self._mac:
            return f"{self.home()}/Library/Caches"
        return self.environment.get("XDG_CACHE_HOME", f"{self.home()}/.cache")

    def runtime(self) -> str:
        """Return the directory of files that last as long as the user's session."""
        if self._windows:
            return f"{self.temporary()}\\runtime"
        default = f"{self.temporary()}/runtime-{self.environment.get('USER', '')}"
        return default if self._mac else self.environment.get("XDG_RUNTIME_DIR", default)

    def shared_data(self) -> list[str]:
        """Return the directories of system-wide data for all programs."""
        return self._shared("XDG_DATA_DIRS", "/usr/local/share:/usr/share", "/usr/local/share:/usr/share")

    def shared_config(self) -> list[str]:
        """Return the directories of system-wide settings for all programs."""
        return self._shared("XDG_CONFIG_DIRS", "/etc/xdg", "/etc:/Library/Preferences")

    def data_home(self) -> str:
        """Return the directory of the user's YARP data: edited contexts and robots."""
        return self.environment.get("YARP_DATA_HOME", self._in(self.data(), "yarp"))

    def config_home(self) -> str:
        """Return the directory of the user's YARP settings, such as ``yarp.conf``."""
        return self.environment.get("YARP_CONFIG_HOME", self._in(self.config(), *self._config_suffix))

    def cache_home(self) -> str:
        """Return the directory of the user's YARP caches."""
        return self.environment.get("YARP_CACHE_HOME", self._in(self.cache(), "yarp"))

    def runtime_home(self) -> str:
        """Return the directory of YARP's files that last as long as the user's session."""
        return self.environment.get("YARP_RUNTIME_DIR", self._in(self.runtime(), "yarp"))

    def data_dirs(self) -> list[str]:
        """Return the directories of system-wide YARP data."""
        if "YARP_DATA_DIRS" in self.environment:
            return self._split(self.environment["YARP_DATA_DIRS"])
        return [self._in(folder, "yarp") for folder in self.shared_data()]

    def config_dirs(self) -> list[str]:
        """Return the directories of system-wide YARP settings."""
        if "YARP_CONFIG_DIRS" in self.environment:
            return self._split(self.environment["YARP_CONFIG_DIRS"])
        return [self._in(folder, *self._config_suffix) for folder in self.shared_config()]

    def robot(self) -> str:
        """Return the robot's name: ``YARP_ROBOT_NAME``, or ``default``."""
        return self.environment.get("YARP_ROBOT_NAME", "default")

    @property
    def _windows(self) -> bool:
        return self.platform == "win32"

    @property
    def _mac(self) -> bool:
        return self.platform == "darwin"

    @property
    def _config_suffix(self) -> Sequence[str]:
        return ("yarp", "config") if self._windows else ("yarp",)

    def _in(self, folder: str, *names: str) -> str:
        return ("\\" if self._windows else "/").join((folder, *names))

    def _split(self, text: str) -> list[str]:
        return [folder for folder in text.split(";" if self._windows else ":") if folder]

    def _shared(self, variable: str, default: str, mac: str) -> list[str]:
        if self._windows:
            return self._split(self.environment.get("ALLUSERSPROFILE", "C:\\ProgramData"))
        return self._split(mac if self._mac else self.environment.get(variable, default))
