"""A stranger's first run: a bare clone in a folder with a space, nothing cached, a busy machine; the demo drives."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from tests.support.process import Process

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 1500
"""For set-up and demo on one core: none of it waits for a clock, so this ends only what hangs."""

_OURS = ("AMENT", "MIDSPAN_CACHE", "PYTEST", "PYTHON", "ROS", "VIRTUAL_ENV", "YARP")
"""Variables that a stranger's shell has not."""

pytestmark = pytest.mark.timeout(2 * SECONDS)

_CI = ROOT / ".cache" / "first-run"
"""Where CI keeps the clone between its two parts: other tests run beside the first, and the second runs alone."""


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """What a clone of this tree has: its files without what is ignored, so nothing that was built."""
    parent = _CI if "CI" in os.environ else tmp_path_factory.mktemp("first")
    folder = parent / "my robots" / "midspan"
    if not folder.exists():
        _copy(folder)
    yield folder
    if parent != _CI:
        shutil.rmtree(parent)


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


@pytest.mark.beside
def test_beside_two_processes_that_compute(clone: Path, tmp_path: Path) -> None:
    """In CI these are the other processes of pytest, and what their tests start."""
    others = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")) - 1
    with _computing(0 if "CI" in os.environ and others >= 2 else 2):
        _assert_reaches_all_rooms(clone, tmp_path, ["make", "demo"])


@pytest.mark.long
def test_on_one_core(clone: Path, tmp_path: Path) -> None:
    """In the same clone, with another home and empty caches; set-up finds the libraries, and builds what is cached."""
    core = min(os.sched_getaffinity(0))
    _assert_reaches_all_rooms(clone, tmp_path, ["taskset", "-c", str(core), "make", "demo"])


@contextmanager
def _computing(count: int) -> Iterator[None]:
    with ExitStack() as stack:
        for _ in range(count):
            stack.enter_context(Process([sys.executable, "-c", "while True: pass"]))
        yield


def _assert_reaches_all_rooms(clone: Path, home: Path, command: Sequence[str]) -> None:
    told = home / "demo.json"
    environ = {name: value for name, value in os.environ.items() if not name.startswith(_OURS)}
    environ |= {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    environ |= {"JSON": str(told), "PNG": str(home / "way.png")}
    with Process(["env", "-C", clone, *command], environ) as demo:
        code = demo.popen.wait(SECONDS)
        said = demo.output()[-4000:]
    assert code == 0, said
    drives = json.loads(told.read_text(encoding="utf-8"))["drives"]
    assert [drive["reached"] for drive in drives] == [True, True, True], said
