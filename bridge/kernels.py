"""The kernels: Python files that Cython compiles at set-up, and whether what is compiled fits what lies here.

A kernel is ordinary Python with C types in its annotations (Cython's pure Python mode), so that it also runs where it
is not compiled: some hundred times slower, which is enough to convert messages and not enough to drive. A build writes
the digest of each kernel into `RECORD`; by it a stale build is told. This file needs the standard library alone, since
set-up runs it before anything is installed.
"""

from __future__ import annotations

import hashlib
import importlib.machinery
import importlib.metadata
import json
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
"""Modules that are compiled, each from its own ``.py``."""

SHARED = "bridge.shared_kernel_code"
"""Module of what Cython gives every kernel, so that it is compiled once."""

C_MODULES: tuple[str, ...] = ("bridge.adapters.ros2.service_callbacks",)
"""Modules that are written in C, each beside what uses it; without a compiler they are not there."""

FLAGS = ("/O2",) if sys.platform == "win32" else ("-O3", "-g0", "-ffp-contract=off")
"""For the C compiler: no ``-march=native``, since wheels go to other machines, and the same numbers on all of them."""

SHARED_FLAGS = ("/O1",) if sys.platform == "win32" else ("-O1", "-g0")

RECORD = "kernels.json"
"""Beside this file: digest of each module as it was built."""

_CHECKOUT = (ROOT / "setup.py").is_file()

REBUILD = "run 'make setup'" if _CHECKOUT else "pip install --force-reinstall --no-deps --no-binary midspan midspan"
"""What compiles them anew."""

CURE = f"install a C compiler and Python's headers (Debian: apt install g++ python3-dev), then {REBUILD}"


@dataclass(frozen=True, slots=True)
class KernelState:
    """Which kernels are not compiled, and which come from other sources, another Cython or other flags."""

    missing: tuple[str, ...]
    stale: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether each is compiled, of the sources that lie here."""
        return not self.missing and not self.stale

    def __str__(self) -> str:
        parts = [
            f"{len(names)} of {len(KERNELS) + len(C_MODULES) + 1} kernels {are}: {', '.join(names)}"
            for names, are in ((self.missing, "not compiled"), (self.stale, "compiled of other sources"))
            if names
        ]
        return "; ".join(parts) or "all kernels are compiled"


def source(module: str) -> Path:
    """The file that a module is compiled from."""
    return ROOT / (module.replace(".", "/") + (".c" if module in C_MODULES else ".py"))


def built(module: str) -> Path | None:
    """Its compiled file, None where there is none."""
    stem = ROOT / module.replace(".", "/")
    files = (stem.with_name(stem.name + suffix) for suffix in importlib.machinery.EXTENSION_SUFFIXES)
    return next((file for file in files if file.is_file()), None)


def digest(module: str, compiler: str) -> str:
    """Digest of what a module's build depends on: its source, Cython's version and the flags."""
    content = hashlib.sha256(repr((compiler, FLAGS, SHARED_FLAGS)).encode())
    if module != SHARED:
        content.update(source(module).read_bytes())
    return content.hexdigest()


def record() -> Mapping[str, str]:
    """What was built: the digest of each module, and Cython's version under ``cython``."""
    try:
        found = json.loads((ROOT / "bridge" / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def compiler_version() -> str:
    """Version of the Cython that is installed, "" where none is."""
    try:
        return importlib.metadata.version("cython")
    except importlib.metadata.PackageNotFoundError:
        return ""


def state() -> KernelState:
    """How the kernels are, as the Cython that is installed would build them; in a wheel, as the one that built."""
    known = record()
    compiler = (compiler_version() if _CHECKOUT else "") or known.get("cython", "")
    modules = (*KERNELS, *C_MODULES, SHARED)
    missing = tuple(module for module in modules if built(module) is None)
    stale = tuple(m for m in modules if m not in missing and known.get(m) != digest(m, compiler))
    return KernelState(missing, stale)


if __name__ == "__main__":
    _found = state()
    print(_found if sys.argv[1:] != ["count"] else len(_found.missing) + len(_found.stale))
    sys.exit(not _found.ok)
