"""What `make test-everywhere` expects of the demo on a machine without DART."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from scripts import everywhere

REASON = "the demo needs more than this machine has:\nsimulation: the simulator needs dartpy, which is not installed"


def demo(folder: Path, *, dart: bool, output: str, code: int) -> tuple[int, str]:
    """Run the step with a Python that has DART or not, and a demo with this output and exit code."""
    (folder / "output").write_text(output)
    programs = {".venv/bin/python": f"exit {0 if dart else 1}", "make": f"cat {folder}/output >&2; exit {code}"}
    for name, command in programs.items():
        program = folder / name
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(f"#!/bin/sh\n{command}\n")
        program.chmod(0o755)
    env = os.environ | {"PATH": f"{folder}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["sh", "-c", everywhere.DEMO], cwd=folder, env=env, capture_output=True, text=True, check=False
    )
    return done.returncode, everywhere._result("demo", done.returncode, done.stdout + done.stderr)


@pytest.mark.parametrize(
    ("dart", "output", "code", "passes", "cell"),
    [
        (True, "9 s; the path was drawn", 0, True, "passed"),
        (True, "a room was not reached", 1, False, "exit code 1: a room was not reached"),
        (False, REASON, 1, True, "no simulator, because DART has no wheel; the demo reports that"),
        (False, f"{REASON}\npip install 'midspan[demo]' installs it", 1, False, "exit code 1: "),
        (False, "Traceback", 1, False, "exit code 1: Traceback"),
        (False, "9 s; the path was drawn", 0, False, "exit code 1: the demo runs without DART"),
    ],
)
def test_the_demo_runs_or_names_the_reason(
    tmp_path: Path, *, dart: bool, output: str, code: int, passes: bool, cell: str
) -> None:
    result, text = demo(tmp_path, dart=dart, output=output, code=code)
    assert (result == 0) == passes
    assert text.startswith(cell)
