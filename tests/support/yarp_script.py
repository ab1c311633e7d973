"""Scripts for YARP's Python bindings, run unchanged on `yarp_compat`, each a program of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

SCRIPTS = Path(__file__).parents[1] / "yarp_compat" / "scripts"
_FOREIGN = ("YARP_", "ROS_", "AMENT_", "CMAKE_")


def start(script: str, folder: Path, *words: str, **variables: str) -> subprocess.Popen[str]:
    """Start a script where no ROS is known.

    Args:
        script: its file's name without ``.py``.
        folder: has ``yarp.conf``; the program's working folder.
        words: its arguments.
        variables: of its environment.
    """
    clean = {name: value for name, value in os.environ.items() if not name.startswith(_FOREIGN)}
    return subprocess.Popen(
        [sys.executable, "-m", "yarp_compat", str(SCRIPTS / f"{script}.py"), *words],
        env=clean | {"YARP_CONFIG_HOME": str(folder), "PYTHONUNBUFFERED": "1", **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )


def said(program: subprocess.Popen[str], seconds: float = 60) -> list[str]:
    """The lines that a script printed itself, at its end; the library's own begin with their level."""
    try:
        out, err = program.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        program.kill()
        out, err = program.communicate()
    assert program.returncode == 0, f"{out}\n{err}"
    # two threads may print at once: a line of the library's may stand between a text and its end
    return re.sub(r"\[[A-Z]+\] \|[^\n]*\n", "", out).splitlines()
