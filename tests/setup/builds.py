"""What the set-up has compiled, for tests that set Midspan up again, and compile only one part of each kind."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from bridge.interfaces.cache import BuildCache, default_cache

KERNEL = "sim.depth_kernel"
PACKAGE = "octomap_msgs"
"""The kernel and the message package that are not copied, because they take the least time to compile."""


def copy_kernels(folder: Path) -> bool:
    """Copy the cache of compiled kernels except one; return whether this machine has a cache, as CI does."""
    cache = os.environ.get("MIDSPAN_KERNEL_CACHE")
    if not cache:
        return False
    folder.mkdir(parents=True)
    for kernel in Path(cache).iterdir():
        module, _, key = kernel.name.rpartition("-")
        if module != KERNEL and "." not in key:  # another process may be writing NAME-KEY.PID
            shutil.copy2(kernel, folder)
    return True


def copy_packages(folder: Path) -> None:
    """Copy the cache of built message packages except one."""
    for package in BuildCache(default_cache()).packages():
        if not package.name.startswith(f"{PACKAGE}-"):
            shutil.copytree(package, folder / "packages" / package.name, symlinks=True)
