"""Makes a process, or the programs of a virtual environment, find built packages."""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Iterable, Sequence
from pathlib import Path

from bridge.interfaces.errors import BuildError
from bridge.interfaces.ros2 import Ros2
from bridge.interfaces.store import SITE, members

_PTH = "midspan_interfaces.pth"


def activate(*prefixes: Path) -> tuple[str, ...]:
    """Make this process, and those it starts, find the packages of these prefixes, before any others of their names.

    Returns:
        Names of packages that this process has imported from elsewhere already. It goes on with what it has, since
        neither Python nor the dynamic loader can load a package again: start a new process to use the new ones.

    Raises:
        BuildError: two prefixes hold different builds of one package.
    """
    packages = _merged(prefixes)
    for prefix in reversed(prefixes):
        sys.path[:] = [str(prefix / SITE), *(entry for entry in sys.path if entry != str(prefix / SITE))]
    os.environ["AMENT_PREFIX_PATH"] = _joined([str(prefix) for prefix in prefixes], "AMENT_PREFIX_PATH")
    return tuple(name for name, folder in packages.items() if _is_loaded_from_elsewhere(name, folder))


def environment(prefixes: Sequence[Path]) -> dict[str, str]:
    """Variables for a new Python process that shall find ROS 2's libraries and the packages of these prefixes.

    Lay them over a copy of `os.environ`.

    Raises:
        BuildError: two prefixes hold different builds of one package.
    """
    _merged(prefixes)
    return {
        "PYTHONPATH": _joined([str(prefix / SITE) for prefix in prefixes], "PYTHONPATH"),
        "AMENT_PREFIX_PATH": _joined([str(prefix) for prefix in prefixes], "AMENT_PREFIX_PATH"),
        "LD_LIBRARY_PATH": _joined([str(folder) for folder in Ros2.find().libraries], "LD_LIBRARY_PATH"),
        # the wheels restart Python once to set LD_LIBRARY_PATH, unless told that it is set
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }


def link_into_venv(prefix: Path) -> Path | None:
    """Let every program of this virtual environment import the packages of a prefix; returns the file that does it.

    None where this Python is not in a virtual environment: then nothing is touched.
    """
    if sys.prefix == sys.base_prefix:
        return None
    file = Path(sysconfig.get_path("purelib")) / _PTH
    line = f"{prefix / SITE}\n"
    if not file.is_file() or file.read_text(encoding="utf-8") != line:
        scratch = file.with_suffix(".new")
        scratch.write_text(line, encoding="utf-8")
        scratch.replace(file)
    return file


def _merged(prefixes: Iterable[Path]) -> dict[str, Path]:
    """Built packages of all prefixes by name."""
    found: dict[str, Path] = {}
    for prefix in prefixes:
        for name, folder in members(prefix).items():
            if found.setdefault(name, folder) != folder:
                raise BuildError(
                    f"package {name} is in {prefix} and in another prefix, with different contents",
                    cure="Build all packages that one process uses together, in one call",
                )
    return found


def _joined(entries: Sequence[str], variable: str) -> str:
    present = [entry for entry in os.environ.get(variable, "").split(os.pathsep) if entry]
    return os.pathsep.join(dict.fromkeys((*entries, *present)))


def _is_loaded_from_elsewhere(name: str, folder: Path) -> bool:
    module = sys.modules.get(name)
    file = getattr(module, "__file__", None)
    return module is not None and (file is None or not Path(file).resolve().is_relative_to(folder))
