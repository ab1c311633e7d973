"""``midspan completion``."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from bridge.cli.main import VERBS, main
from bridge.cli.setup.install import SHELLS


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_has_all_verbs_and_its_shell_accepts_it(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for verb in VERBS:
        assert verb in script
    program = shutil.which(shell)
    if program is not None:
        done = subprocess.run([program, "-n"], input=script, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


def test_bash_completes_a_verb(capsys: pytest.CaptureFixture[str]) -> None:
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("bash is not installed")
    main(["completion", "bash"])
    script = capsys.readouterr().out
    ask = """
    COMP_WORDS=(midspan config ch); COMP_CWORD=2
    "$(complete -p midspan | sed 's/.*-F \\([^ ]*\\).*/\\1/')" midspan ch config 2>/dev/null
    echo "${COMPREPLY[@]}"
    """
    done = subprocess.run([bash], input=script + ask, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["check"], done.stderr
