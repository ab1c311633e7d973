"""Runs the tests of a folder in another pytest, for tests of this suite's own plugins."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def run_tests(folder: Path, *options: str, **environ: str) -> subprocess.CompletedProcess[str]:
    """Run a folder's tests in the order of their files; they can import plugins of this suite."""
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:randomly", *options],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_ADDOPTS": "", **environ},
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
