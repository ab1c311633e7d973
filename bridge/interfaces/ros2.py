"""The installed ROS 2: the wheels of this Python, or a sourced installation such as /opt/ros/jazzy.

Both are prefixes with the same layout (``share/<package>``, ``include``, ``lib``).
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import re
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bridge.interfaces.definition import BuildError

MARK = "share/midspan/interfaces"  # a prefix with this file was built by Midspan, and is not an installation
GENERATORS = (
    "rosidl_generator_c",
    "rosidl_generator_py",
    "rosidl_typesupport_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_introspection_c",
)
_RUNTIME = ("rosidl_adapter", "rosidl_runtime_c", "rosidl_parser", "rmw", "rcutils", "fastcdr")
_INDEX = "share/ament_index/resource_index/rosidl_interfaces"
_CURE = "Run `make` for the wheels, or source /opt/ros/jazzy/setup.bash (apt: ros-jazzy-ros-base)"


@dataclass(frozen=True, slots=True)
class InstalledPackage:
    """A message package of the installation."""

    name: str
    prefix: Path

    @property
    def share(self) -> Path:
        """Folder with the package's ``msg``, ``srv`` and ``action``."""
        return self.prefix / "share" / self.name

    @property
    def version(self) -> str:
        """The version in the package's ``package.xml``; "" without one."""
        return _version(self.share / "package.xml")

    def has(self, path: str) -> bool:
        """Return whether the package has a definition, given as ``msg/Name.msg``."""
        return (self.share / path).is_file() or (self.share / path).with_suffix(".idl").is_file()


class Ros2:
    """The installed ROS 2, as far as building and using message packages needs it."""

    def __init__(self, prefixes: tuple[Path, ...]) -> None:
        self.prefixes = prefixes

    @classmethod
    def find(cls) -> Ros2:
        """Find the installation that this process would use; raises `BuildError`."""
        named = [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if entry]
        spec = importlib.util.find_spec("rosidl_parser")
        if spec is None or spec.origin is None:
            raise BuildError("ROS 2's message generators (rosidl) are not installed for this Python", cure=_CURE)
        # <prefix>/lib/python3.x/site-packages/rosidl_parser/__init__.py
        named.append(Path(spec.origin).parents[4])
        return cls(tuple(dict.fromkeys(entry for entry in named if entry.is_dir() and not (entry / MARK).exists())))

    @cached_property
    def packages(self) -> dict[str, InstalledPackage]:
        """The message packages, by name."""
        packages: dict[str, InstalledPackage] = {}
        for prefix in self.prefixes:
            index = prefix / _INDEX
            for entry in sorted(index.iterdir()) if index.is_dir() else ():
                packages.setdefault(entry.name, InstalledPackage(entry.name, prefix))
        return packages

    @cached_property
    def libraries(self) -> tuple[Path, ...]:
        """Folders with the shared libraries."""
        wheels = [folder for prefix in self.prefixes for folder in prefix.glob("lib/python3*/site-packages/ros_*.libs")]
        return tuple(folder for folder in (*(prefix / "lib" for prefix in self.prefixes), *wheels) if folder.is_dir())

    @cached_property
    def includes(self) -> tuple[Path, ...]:
        """Folders with the headers: one for each package, and the common one."""
        roots = [prefix / "include" for prefix in self.prefixes if (prefix / "include").is_dir()]
        return tuple(folder for root in roots for folder in (root, *sorted(p for p in root.iterdir() if p.is_dir())))

    def resource(self, generator: str) -> Path:
        """Return the folder of a generator's templates."""
        for prefix in self.prefixes:
            folder = prefix / "share" / generator / "resource"
            if folder.is_dir():
                return folder
        raise BuildError(f"ROS 2's generator {generator} is not installed", cure=_CURE)

    @cached_property
    def identity(self) -> str:
        """What a build depends on: versions of the generators, their libraries, Python and NumPy, and the processor."""
        versions = [f"{name} {self._version_of(name)}" for name in (*GENERATORS, *_RUNTIME)]
        numpy = importlib.metadata.version("numpy").partition(".")[0]
        return " ".join([sys.implementation.cache_tag, platform.machine(), f"numpy {numpy}", *versions])

    def _version_of(self, name: str) -> str:
        files = (prefix / "share" / name / "package.xml" for prefix in self.prefixes)
        return next((version for version in map(_version, files) if version), "")


def _version(package_xml: Path) -> str:
    try:
        match = re.search(r"<version[^>]*>\s*([^<\s]+)", package_xml.read_text(encoding="utf-8"))
    except OSError:
        return ""
    return match[1] if match else ""
