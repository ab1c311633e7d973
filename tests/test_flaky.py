"""`scripts/flaky.py` with a `make` that fails now and then: the commands that it runs, and its report."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from scripts import flaky

PROGRAM = Path(flaky.__file__)

pytestmark = pytest.mark.thorough

MAKE = f"""#!{sys.executable}
import json, os, re, sys
from pathlib import Path

target, strict, arguments = sys.argv[4:]
assert strict == "STRICT=1"
seed = int(re.search(r"--randomly-seed=(\\d+)", arguments)[1])
parents = [stat.read_text().split(") ")[1].split()[1] for stat in Path("/proc").glob("[0-9]*/stat")]
busy, cores = parents.count(str(os.getppid())) - 1, len(os.sched_getaffinity(0))
record = {{"target": target, "arguments": arguments, "cores": cores, "busy": busy}}
Path(__file__).with_name(f"record-{{seed}}").write_text(json.dumps(record))
print("....", "x" * seed)
if seed >= 3:
    print("FAILED tests/a.py::test_often[Image 1 MB] - assert 1 == 2")
if seed == 4:
    print("ERROR    midspan.web:worker.py:12 a line of a log")
    print("ERROR tests/b.py::test_once")
    print("FAILED tests/a.py::test_often[Image 1 MB] - assert 1 == 2")
    print("LEFT BEHIND: process 12")
print(f"===== {{seed}} passed in 1 s =====")
sys.exit(seed >= 3)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "make").write_text(MAKE)
    (tmp_path / "make").chmod(0o755)
    return tmp_path


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, PROGRAM, "--logs", folder / "logs", *arguments],
        env={**os.environ, "PATH": f"{folder}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )


def recorded(folder: Path, seed: int) -> dict[str, object]:
    record: dict[str, object] = json.loads((folder / f"record-{seed}").read_text())
    return record


def test_each_failed_test_is_listed_with_its_runs(folder: Path) -> None:
    done = run(folder, "4")
    assert done.returncode == 1
    assert re.match(r"run 1: \d+ s, nothing failed: 1 passed in 1 s\n", done.stdout)
    assert done.stdout.partition("\n\n")[2].splitlines() == [
        "2 of 4 runs failed",
        "   2 of 4  tests/a.py::test_often[Image 1 MB]  (run 3, 4)",
        "   1 of 4  tests/b.py::test_once  (run 4)",
        "   1 of 4  LEFT BEHIND: process 12  (run 4)",
    ]
    assert "xxx" in (folder / "logs" / "run-3.log").read_text()


def test_a_run_without_failures_succeeds(folder: Path) -> None:
    done = run(folder, "2", "--target", "test-all", "tests/hub", "-k", "latched or $HOME")
    assert done.returncode == 0
    assert "0 of 2 runs failed" in done.stdout
    assert recorded(folder, 2)["target"] == "test-all"
    assert recorded(folder, 2)["arguments"] == "ARGS=tests/hub -k 'latched or $$HOME' --randomly-seed=2"


def test_a_run_without_a_failed_test_may_fail(folder: Path) -> None:
    (folder / "make").write_text("#!/bin/sh\necho no rule to make test\nexit 2\n")
    done = run(folder, "1", "--seed", "7")
    assert done.returncode == 1
    assert f"no test: make ended with exit code 2, see {folder / 'logs' / 'run-7.log'}" in done.stdout


def test_tests_run_beside_busy_processes_and_on_one_core(folder: Path) -> None:
    assert run(folder, "1").returncode == 0
    assert recorded(folder, 1)["busy"] == 0
    assert run(folder, "1", "--busy", "2", "--one-core").returncode == 0
    assert recorded(folder, 1)["busy"] == 2
    assert recorded(folder, 1)["cores"] == 1


def test_busy_processes_end_with_the_runs() -> None:
    with flaky.busy(1) as processes:
        (process,) = processes
        busy = psutil.Process(process.pid)
        assert busy.is_running()
    assert not busy.is_running()
