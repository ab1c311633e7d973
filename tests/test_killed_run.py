"""The folders of a test run that was killed do not fail the next run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.missing import DEBIAN, needs

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.thorough
@needs(DEBIAN)
def test_a_folder_with_a_mount_does_not_fail_the_next_run(tmp_path: Path) -> None:
    """Killed tests with debootstrap leave such a folder; here, the mount exists only in the namespace of this run."""
    mount = tmp_path / "pytest-of-root" / "garbage-1" / "tree"
    mount.mkdir(parents=True)
    test = tmp_path / "test_it.py"
    test.write_text("def test_it(tmp_path):\n    assert tmp_path.exists()\n")
    pytest_command = [sys.executable, "-m", "pytest", "-c", ROOT / "pyproject.toml", "-p", "no:cacheprovider", test]
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", 'mount -t tmpfs tmpfs "$0" && exec "$@"', mount, *pytest_command],
        env={**os.environ, "PYTEST_DEBUG_TEMPROOT": str(tmp_path), "PYTEST_ADDOPTS": "-p no:randomly"},
        capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout
