"""`scripts/unsteady.py`: failed tests run once more; the run fails if many tests failed, or if one fails again."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from scripts import unsteady
from scripts.unsteady import ROOT

pytestmark = pytest.mark.thorough


def run(tmp_path: Path, *failed: str) -> subprocess.CompletedProcess[str]:
    kept = tmp_path / "v" / "cache"
    kept.mkdir(parents=True)
    (kept / "lastfailed").write_text(json.dumps(dict.fromkeys(failed, True)))
    (tmp_path / "v" / "midspan").mkdir()
    (tmp_path / "v" / unsteady.SEED).write_text("7")
    command = [sys.executable, unsteady.__file__, "--kept", str(tmp_path)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)


def test_a_run_that_failed_without_a_failed_test_stays_failed(tmp_path: Path) -> None:
    assert run(tmp_path).returncode == 1
    assert unsteady.main(["--kept", str(tmp_path / "none")]) == 1


def test_a_test_that_passes_by_itself_is_named(tmp_path: Path) -> None:
    test = tmp_path / "test_now.py"
    test.write_text("def test_it():\n    assert True\n")
    done = run(tmp_path, f"{test}::test_it")
    assert done.returncode == 0, done.stdout
    assert done.stdout.splitlines()[-2:] == [
        "UNSTEADY, to be fixed: 1 failed in the whole run (--randomly-seed=7) and passed now",
        f"  {test}::test_it",
    ]


def test_a_test_that_fails_again_fails_the_run(tmp_path: Path) -> None:
    test = tmp_path / "test_now.py"
    test.write_text("def test_it():\n    assert False\n\n\ndef test_other():\n    assert True\n")
    done = run(tmp_path, f"{test}::test_it", f"{test}::test_other")
    assert done.returncode == 1
    assert "UNSTEADY" not in done.stdout


def test_a_test_that_is_gone_fails_the_run(tmp_path: Path) -> None:
    assert run(tmp_path, f"{tmp_path}/test_gone.py::test_it").returncode == 1


def test_many_failed_tests_fail_the_run_without_another_try(tmp_path: Path) -> None:
    done = run(tmp_path, *(f"tests/test_a.py::test_{n}" for n in range(unsteady.MOST + 1)))
    assert done.returncode == 1
    assert "6 tests failed" in done.stdout


@pytest.mark.parametrize(("strict", "code"), [("", 0), ("STRICT=1", 2)])
def test_make_test_runs_failed_tests_once_more(tmp_path: Path, strict: str, code: int) -> None:
    """The test fails only the first time; the set-up is left out."""
    test = tmp_path / "test_race.py"
    test.write_text(
        "from pathlib import Path\n\n\ndef test_it():\n    first = Path(__file__).with_name('first')\n"
        "    again = first.exists()\n    first.touch()\n    assert again\n"
    )
    shutil.copy(ROOT / "Makefile", tmp_path)
    (tmp_path / "scripts").mkdir()
    shutil.copy(ROOT / "scripts" / "unsteady.py", tmp_path / "scripts")
    (tmp_path / "scripts" / "setup.sh").write_text("#!/bin/sh\n")
    (tmp_path / "scripts" / "setup.sh").chmod(0o755)
    folder = Path(sys.executable).parent
    pytest_command = f"{folder}/python -m pytest -o cache_dir=.cache/pytest -p no:randomly -p no:hypothesispytest"
    done = subprocess.run(
        ["make", "-C", tmp_path, f"BIN={folder}", f"pytest={pytest_command}", "test", strict or "STRICT=", "ARGS=-n0"],
        capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert done.returncode == code, done.stdout + done.stderr
    assert ("UNSTEADY" in done.stdout) == (not strict)


def collected(*arguments: str) -> set[str]:
    """Return the names of tests as pytest collects them."""
    command = [sys.executable, "-m", "pytest", "-q", "--collect-only", "-p", "no:cacheprovider", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=100)
    return {line for line in done.stdout.splitlines() if "::" in line}


@pytest.mark.parametrize("file", ["contract/test_topics.py", "interop/test_parameters.py"])
def test_tests_have_the_same_names_by_themselves_and_in_a_whole_run(file: str) -> None:
    """A whole run begins with tests/, so it loads the conftest.py of a folder later."""
    folder = Path(file).parts[0]
    others = [path for path in (ROOT / "tests").iterdir() if path.is_dir() and path.name != folder]
    whole = collected("tests", *(f"--ignore={path}" for path in others))
    by_itself = collected(f"tests/{file}")
    assert by_itself
    assert by_itself <= whole
