"""The command ``python -m yarp_compat``: help, invalid command lines, and a script's own options."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "yarp_compat", *words],
        cwd=folder,
        env={"PYTHONPATH": str(Path(__file__).parents[2]), "YARP_CONFIG_HOME": str(folder)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("words", [("--help",), ("-h",), ("--check", "--help"), ("--help", "script.py")])
def test_help_shows_the_usage(tmp_path: Path, words: tuple[str, ...]) -> None:
    ended = run(tmp_path, *words)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith("usage: python -m yarp_compat script.py")
    assert "--check" in ended.stdout


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ((), "usage:"),
        (("--chek", "script.py"), "unknown option '--chek'"),
        (("nowhere.py",), "script 'nowhere.py' not found"),
        (("folder",), "'folder' is a folder without __main__.py"),
        (("--check",), "usage:"),
    ],
)
def test_an_invalid_command_line_prints_the_usage(tmp_path: Path, words: tuple[str, ...], error: str) -> None:
    (tmp_path / "folder").mkdir()
    ended = run(tmp_path, *words)
    assert ended.returncode == 1
    assert error in ended.stderr
    assert "usage: python -m yarp_compat" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_script_gets_its_own_options(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for script in ("script.py", "--odd.py", "folder/__main__.py"):
        (tmp_path / script).write_text("import sys\nprint(sys.argv[1:])\n")
    for script in ("script.py", "--odd.py", "folder"):
        ended = run(tmp_path, script, "--help", "--check")
        assert (ended.returncode, ended.stdout) == (0, "['--help', '--check']\n"), ended.stderr
