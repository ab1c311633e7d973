"""The processors for which packages are built, and the settings for a processor other than this machine's.

Debian's cross compiler compiles the kernels. The Python that runs the build reads the compiler's name, flags and
platform from the configuration in Debian's package of the same Python for the other processor.
"""

from __future__ import annotations

import argparse
import platform
import shutil
import sys
import sysconfig
from pathlib import Path

MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
"""Names of processors in the tags of wheels, by Debian's names."""

ELF = {"amd64": 62, "arm64": 183}
"""Numbers of processors in compiled files (``e_machine``)."""


def native() -> str:
    """Return Debian's name of this machine's processor."""
    machine = platform.machine()
    return next((name for name, in_tags in MACHINES.items() if in_tags == machine), machine)


def add_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for the processor."""
    parser.add_argument("--arch", choices=sorted(MACHINES), default=native(), help="processor; default: this machine's")


def environ(arch: str) -> dict[str, str]:
    """Return the variables with which Python builds for a processor; raises `RuntimeError` if packages are missing."""
    if arch == native():
        return {}
    triplet = f"{MACHINES[arch]}-linux-gnu"
    python = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    settings = f"_sysconfigdata__{triplet}"
    if not Path(sysconfig.get_path("include")).is_relative_to("/usr/include"):
        raise RuntimeError(
            f"building for {arch} needs Debian's own Python, not {sys.base_prefix}:"
            " run 'make clean' and 'make setup PYTHON=/usr/bin/python3'"
        )
    missing = [
        what
        for what, exists in (
            (f"the compiler {triplet}-gcc", shutil.which(f"{triplet}-gcc")),
            (f"the settings of {python}", (Path("/usr/lib") / python / f"{settings}.py").exists()),
            (f"the headers of {python}", (Path("/usr/include") / triplet / python / "pyconfig.h").exists()),
        )
        if not exists
    ]
    if missing:
        raise RuntimeError(
            f"building for {arch} needs {', '.join(missing)}; as root: dpkg --add-architecture {arch} && "
            f"apt-get update && apt-get install crossbuild-essential-{arch} libpython3-dev:{arch}"
        )
    return {"_PYTHON_SYSCONFIGDATA_NAME": settings, "_PYTHON_HOST_PLATFORM": f"linux-{MACHINES[arch]}"}
