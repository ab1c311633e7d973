"""The kernels, which are Python files that Cython compiles at setup, and the check for missing and stale builds.

A kernel is ordinary Python with C types in its annotations (Cython's pure Python mode), so it also runs uncompiled,
about a hundred times slower, which is fast enough to convert messages but not to drive. A build writes the digest of
each kernel to `RECORD`, which reveals a stale build. This file needs only the standard library, because the setup runs
it before anything is installed.
"""

from __future__ import annotations

import hashlib
import importlib.machinery
import importlib.metadata
import json
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

KERNELS = (
    "bridge.bags.split",
    "bridge.messages.transcode.vm",
    "bridge.tf.history",
    "bridge.tf.message",
    "navigation.algorithms.astar",
    "navigation.algorithms.distance_transform",
    "navigation.algorithms.likelihood_field",
    "navigation.algorithms.occupancy",
    "navigation.algorithms.pose_search",
    "navigation.algorithms.potential_field",
    "navigation.algorithms.rolling_grid",
    "navigation.algorithms.shortcut",
    "navigation.algorithms.stopping",
    "navigation.algorithms.voxel_layer",
    "navigation.algorithms.voxel_leaves",
    "navigation.algorithms.voxel_map",
    "navigation.maps.kernels",
    "sim.depth_kernel",
    "sim.laser_kernel",
)
"""The compiled modules, each built from its ``.py`` file."""

SHARED = "bridge.shared_kernel_code"
"""The module with the code that all kernels share, so that this is compiled only once."""

C_MODULES: tuple[str, ...] = (
    "bridge.adapters.ros1.intake",
    "bridge.adapters.ros1.topics.outputs",
    "bridge.adapters.ros2.reader_filter",
    "bridge.adapters.ros2.service_callbacks",
    "bridge.adapters.ros2.taking",
    "bridge.adapters.ros2.topics.writing",
    "bridge.hub.lane.links",
    "bridge.hub.lane.receiving",
    "bridge.messages.buffers",
    "bridge.routing.doorway",
    "bridge.routing.exit",
)
"""Modules in C, each next to the module that uses it; they are missing if there was no compiler."""

DRIVING: tuple[str, ...] = (
    "bridge.messages.transcode.vm",
    "bridge.tf.history",
    "bridge.tf.message",
    "navigation.algorithms.astar",
    "navigation.algorithms.distance_transform",
    "navigation.algorithms.occupancy",
    "navigation.algorithms.potential_field",
    "navigation.algorithms.rolling_grid",
    "navigation.algorithms.shortcut",
    "navigation.algorithms.stopping",
    "navigation.maps.kernels",
    SHARED,
)
"""The kernels that RobotGoto and RobotPathPlanner import: if one is not compiled, these modules refuse all goals."""

FLAGS = ("/O2",) if sys.platform == "win32" else ("-O3", "-g0", "-ffp-contract=off")
"""Flags of the C compiler; without ``-march=native``, so that wheels run and compute the same on all machines."""

SHARED_FLAGS = ("/O1",) if sys.platform == "win32" else ("-O1", "-g0")

RECORD = "kernels.json"
"""The file with the digest of each built module, next to this file."""

_CHECKOUT = (ROOT / "setup.py").is_file()

REBUILD = "run 'make setup'" if _CHECKOUT else "pip install --force-reinstall --no-deps --no-binary midspan midspan"
"""The command that compiles the kernels again."""

CURE = f"install a C compiler and Python's headers (Debian: apt install g++ python3-dev), then {REBUILD}"


@dataclass(frozen=True, slots=True)
class KernelState:
    """The kernels that are not compiled, and those built from other sources, with another Cython or other flags."""

    missing: tuple[str, ...]
    stale: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether all kernels are compiled from the current sources."""
        return not self.missing and not self.stale

    def __str__(self) -> str:  # type: ignore[explicit-override]  # the setup has only the standard library
        parts = [
            f"{len(names)} of {len(KERNELS) + len(C_MODULES) + 1} kernels {are}: {', '.join(names)}"
            for names, are in ((self.missing, "not compiled"), (self.stale, "compiled from other sources"))
            if names
        ]
        return "; ".join(parts) or "all kernels are compiled"


def source(module: str) -> Path:
    """Return the source file of a module."""
    return ROOT / (module.replace(".", "/") + (".c" if module in C_MODULES else ".py"))


def built(module: str) -> Path | None:
    """Return the compiled file of a module, None if it is missing."""
    stem = ROOT / module.replace(".", "/")
    files = (stem.with_name(stem.name + suffix) for suffix in importlib.machinery.EXTENSION_SUFFIXES)
    return next((file for file in files if file.is_file()), None)


def digest(module: str, compiler: str) -> str:
    """Return the digest of everything on which a module's build depends: sources, Cython's version and flags."""
    content = hashlib.sha256(repr((compiler, FLAGS, SHARED_FLAGS)).encode())
    if module != SHARED:
        for file in _included(source(module)) if module in C_MODULES else (source(module),):
            content.update(file.read_bytes())
    return content.hexdigest()


def _included(file: Path) -> list[Path]:
    """Return a file in C and the headers that it includes."""
    files, texts = [], [file]
    while texts:
        files.append(text := texts.pop().resolve())
        headers = re.findall(r'^#include "(.+)"$', text.read_text(encoding="utf-8"), re.MULTILINE)
        texts += [text.parent / header for header in headers if (text.parent / header).resolve() not in files]
    return files


def record() -> Mapping[str, str]:
    """Return the record of the build: the digest of each module, and Cython's version under ``cython``."""
    try:
        digests = json.loads((ROOT / "bridge" / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return digests if isinstance(digests, dict) else {}


def compiler_version() -> str:
    """Return the version of the installed Cython, "" if there is none."""
    try:
        return importlib.metadata.version("cython")
    except importlib.metadata.PackageNotFoundError:
        return ""


def state() -> KernelState:
    """Compare the kernels with the current sources and the installed Cython (in a wheel, the one that built it)."""
    known = record()
    compiler = (compiler_version() if _CHECKOUT else "") or known.get("cython", "")
    modules = (*KERNELS, *C_MODULES, SHARED)
    missing = tuple(module for module in modules if built(module) is None)
    stale = tuple(m for m in modules if m not in missing and known.get(m) != digest(m, compiler))
    return KernelState(missing, stale)


if __name__ == "__main__":
    _state = state()
    print(_state if sys.argv[1:] != ["count"] else len(_state.missing) + len(_state.stale))
    sys.exit(not _state.ok)
