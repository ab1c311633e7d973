"""A newcomer's first run: a bare clone in a folder with a space, on a busy machine; the demo must drive.

The caches are empty, but in CI they contain most of the compiled code.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.setup.builds import copy_kernels, copy_packages
from tests.support.process import Process

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 1500
"""Time limit for set-up and demo on one core. Neither depends on timing, so only a hang takes this long."""

_OURS = (
    "AMENT", "BROWSER", "CI", "KILTED", "MIDSPAN_CACHE", "MIDSPAN_KERNEL_CACHE", "PIP_NO_COMPILE", "PYTEST", "PYTHON",
    "ROS", "VIRTUAL_ENV", "YARP",
)  # fmt: skip
"""Prefixes of variables that a newcomer's shell does not have; ``CI`` makes the set-up install what only tests use."""

pytestmark = pytest.mark.timeout(2 * SECONDS)

_FOLDER = ROOT / ".cache" / "first-run"
"""The folder with the clone and the user's home, which both tests use, in two processes of pytest-xdist; `make` removes
what a failed run left behind."""

_LOCK = _FOLDER.with_suffix(".lock")
"""Only one test uses the folder at a time: `make demo` would otherwise set up a clone that is being set up."""

_CACHE = _FOLDER / "home" / "cache"
_PACKAGES = _CACHE / "midspan" / "interfaces"
_KERNELS = _CACHE / "kernels"


@pytest.fixture
def clone() -> Iterator[Path]:
    """Return a clone of this tree: its files without ignored ones, so without anything that was built."""
    folder = _FOLDER / "my robots" / "midspan"
    _LOCK.parent.mkdir(exist_ok=True)
    with _LOCK.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            _copy(folder)
            # compiling everything would take two minutes of processor time, and CI's own set-up has checked it already
            if copy_kernels(_KERNELS):
                copy_packages(_PACKAGES)
        yield folder


def _copy(folder: Path) -> None:
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


@pytest.mark.long
def test_a_clone_is_set_up_on_a_busy_machine(clone: Path) -> None:
    """The other tests are the load."""
    with Process(["env", "-C", clone, "make", "setup"], _environ()) as setup:
        assert setup.popen.wait(SECONDS) == 0, setup.output()[-4000:]


@pytest.mark.long
@pytest.mark.alone
def test_the_demo_drives_on_one_core(clone: Path) -> None:
    """If the other test has run, the clone is already set up. tests/demo runs the demo on a busy machine."""
    report = _FOLDER / "home" / "demo.json"
    environ = {**_environ(), "JSON": str(report), "PNG": str(report.with_name("way.png"))}
    report.unlink(missing_ok=True)
    core = min(os.sched_getaffinity(0))
    with Process(["env", "-C", clone, "taskset", "-c", str(core), "make", "demo"], environ) as demo:
        code = demo.popen.wait(SECONDS)
        output = demo.output()[-4000:]
    assert code == 0, output
    drives = json.loads(report.read_text(encoding="utf-8"))["drives"]
    assert [drive["reached"] for drive in drives] == [True, True, True], output
    shutil.rmtree(_FOLDER)


def _environ() -> dict[str, str]:
    """Return the environment of a newcomer's shell, with an empty home."""
    home = _FOLDER / "home"
    home.mkdir(exist_ok=True)
    environ = {name: value for name, value in os.environ.items() if not name.startswith(_OURS)}
    environ |= {"HOME": str(home), "XDG_CACHE_HOME": str(_CACHE), "PYTHONDONTWRITEBYTECODE": "1"}
    return environ | ({"MIDSPAN_KERNEL_CACHE": str(_KERNELS)} if _KERNELS.is_dir() else {})
