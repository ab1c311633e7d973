"""The framework of the command line: verbs, help, errors and exit codes."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bridge.cli.main import VERBS, build_parser, main


def midspan(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "bridge.cli.main", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def verbs_of(parser: argparse.ArgumentParser) -> list[Any]:
    return [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]


def leaves(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """Return the parsers of the innermost verbs, or the parser of a verb whose subverbs share its function."""
    below = [child for action in verbs_of(parser) for child in action.choices.values()]
    if not below or parser.get_default("run"):
        return [parser]
    return [leaf for child in below for leaf in leaves(child)]


def test_help_names_every_verb_and_imports_none(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    help_text = capsys.readouterr().out
    for name, verb in VERBS.items():
        assert name in help_text
        assert verb.help in " ".join(help_text.split())
    code = (
        "import sys, contextlib\nfrom bridge.cli.main import main\n"
        "with contextlib.suppress(SystemExit): main(['--help'])\n"
        "heavy = {'pydantic', 'zenoh', 'numpy', 'rich', 'rosbags', 'ruamel'} & set(sys.modules)\n"
        "sys.exit(', '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_parser_can_have_only_the_named_verb() -> None:
    assert list(verbs_of(build_parser(["worker"], others=False))[0].choices) == ["worker"]
    assert list(verbs_of(build_parser(["worker"]))[0].choices) == list(VERBS)


def test_help_after_an_option_lists_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help", "worker"])
    assert set(re.findall(r"^ {4}([\w-]+)", capsys.readouterr().out, re.MULTILINE)) >= set(VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_and_its_line_in_the_table(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert all(leaf.get_default("run") for leaf in leaves(verbs_of(build_parser([verb]))[0].choices[verb]))
    with pytest.raises(SystemExit) as ended:
        main([verb, "--help"])
    assert ended.value.code == 0
    assert f"usage: midspan {verb}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [[], ["nonsense"], ["run", "--nonsense"], ["worker"], ["worker", "ros3"], ["config"]]
)
def test_wrong_usage_is_exit_code_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code: object = main(arguments)
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert "usage: midspan" in capsys.readouterr().err


def test_failure_is_one_line_without_traceback(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "check", str(tmp_path / "none.yaml")]) == 1
    assert capsys.readouterr().err == f"{tmp_path}/none.yaml: no such file\n"


@pytest.mark.parametrize(
    ("err", "line"),
    [
        (PermissionError(13, "Permission denied", "a.map"), "a.map: permission denied"),
        (ConnectionRefusedError(111, "Connection refused"), "connection refused"),
        (TimeoutError("no answer within 3 s"), "no answer within 3 s"),
        (OSError(), "OSError:  (--debug shows where)"),
    ],
)
def test_errors_of_the_system_have_no_number(
    err: OSError, line: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_args: object) -> int:
        raise err

    monkeypatch.setattr("bridge.cli.setup.config.run_config", fail)
    assert main(["config", "schema"]) == 1
    assert capsys.readouterr().err == f"midspan: {line}\n"


def test_debug_shows_the_traceback(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fail(_args: object) -> int:
        raise KeyError("why")

    monkeypatch.setattr("bridge.cli.setup.config.run_config", fail)
    assert main(["config", "schema"]) == 1
    assert capsys.readouterr().err == "midspan: KeyError: 'why' (--debug shows where)\n"
    for arguments in (["--debug", "config", "schema"], ["config", "schema", "--debug"]):
        with pytest.raises(KeyError):
            main(arguments)


def test_ctrl_c_exits_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(_args: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("bridge.cli.setup.config.run_config", interrupt)
    assert main(["config", "schema"]) == 130


def test_closed_output_pipe_is_not_an_error() -> None:
    done = subprocess.run(
        ["sh", "-c", f"{shlex.quote(sys.executable)} -m bridge.cli.main config schema | head -n 1"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ,
    )
    assert (done.stdout, done.stderr) == ("{\n", "")


def test_version_is_printed() -> None:
    done = midspan("--version")
    assert done.returncode == 0
    assert done.stdout.startswith("midspan ")


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "cp437", "utf-8"])
def test_characters_that_a_console_lacks_are_escaped(tmp_path: Path, encoding: str) -> None:
    file = tmp_path / "K\u00fcche \u6771.yaml"
    file.write_text("name: a\n")
    code = "import sys; from bridge.cli.main import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", code, "config", "check", str(file)],
        env={**os.environ, "PYTHONIOENCODING": encoding}, capture_output=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout == f"{file}: no problem\n".encode(encoding, "backslashreplace")
