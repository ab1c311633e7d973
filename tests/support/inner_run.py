"""Runs the tests of a folder in another pytest, for tests of this suite's own plugins."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_PLUGINS = ("-p", "xdist.plugin", "-p", "pytest_timeout")
"""All installed plugins would take most of a run's processor time."""


def run_tests(folder: Path, *options: str, **environ: str) -> subprocess.CompletedProcess[str]:
    """Run a folder's tests in the order of their files, with time limits; they can import plugins of this suite."""
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *_PLUGINS, *options],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "PYTEST_ADDOPTS": "",
            "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
            **environ,
        },
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
