"""What a command that needs Linux answers on Windows and macOS: a sentence, not a missing name of Python."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.hidden import as_on

ALL = "from bridge.cli.main import VERBS, build_parser; build_parser(VERBS)"
VERBS = "import sys; from bridge.cli.main import main\nfor words in sys.argv[1:]: print(main(words.split()))"


def run(system: str, code: str, *arguments: str, folder: Path) -> str:
    env = as_on(system) | {"HOME": str(folder), "XDG_STATE_HOME": str(folder), "MIDSPAN_CACHE": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=env, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.parametrize("system", ["windows", "macos"])
def test_every_verb_can_parse_its_arguments(system: str, tmp_path: Path) -> None:
    assert run(system, ALL, folder=tmp_path) == ""


def test_verbs_that_need_linux_name_the_reason(tmp_path: Path) -> None:
    file = tmp_path / "midspan.yaml"
    file.write_text("ros2: {enabled: true}\n")
    output = run(
        "windows", VERBS, "demo", "demo topics", "interfaces build", f"worker ros2 --config {file}", folder=tmp_path
    )
    assert output.count("the demo runs only on Linux") == 2, output
    assert "message packages are built only on Linux" in output, output
    assert "the ROS 2 side runs only on Linux" in output, output
    assert "Error" not in output, output
