"""Runs scripts for YARP's Python bindings unchanged on `yarp_compat`, each as a separate program."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

SCRIPTS = Path(__file__).with_name("scripts")
_FOREIGN = ("YARP_", "ROS_", "AMENT_", "CMAKE_")


def start(script: str, folder: Path, *words: str, **variables: str) -> subprocess.Popen[str]:
    """Start a script without a ROS environment.

    Args:
        script: name of the script's file, without ``.py``.
        folder: the program's working folder, with ``yarp.conf``.
        words: the script's arguments.
        variables: further environment variables.
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


def output_lines(program: subprocess.Popen[str], seconds: float = 60) -> list[str]:
    """Wait until a script exits, and return its output lines without the library's log lines."""
    try:
        out, err = program.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        program.kill()
        out, err = program.communicate()
    assert program.returncode == 0, f"{out}\n{err}"
    # two threads may print at once, so a log line may split an output line
    return re.sub(r"\[[A-Z]+\] \|[^\n]*\n", "", out).splitlines()
