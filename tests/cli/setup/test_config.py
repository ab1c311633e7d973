"""``midspan config``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bridge.cli.main import main
from bridge.config import generate
from bridge.config.load import loads
from bridge.config.model import Config


def test_check_accepts_a_valid_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "good.yaml"
    file.write_text("log: {level: debug}\n")
    assert main(["config", "check", str(file)]) == 0
    assert capsys.readouterr().out == f"{file}: no problem\n"
    assert main(["config", "check", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": str(file), "problems": []}


def test_check_reports_each_problem_with_line_and_column(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text("log:\n  levl: debug\n  level: x\n")
    assert main(["config", "check", str(file)]) == 1
    errors = capsys.readouterr().err.splitlines()
    assert errors[0] == f"{file}:2:3: log.levl: unknown key 'levl'; did you mean 'level'?"
    assert len(errors) == 2
    assert main(["config", "check", str(file), "--json"]) == 1
    problem = json.loads(capsys.readouterr().out)["problems"][0]
    assert (problem["line"], problem["column"], problem["key"]) == (2, 3, "log.levl")


def test_check_finds_the_same_file_as_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "some.yaml"
    file.write_text("")
    monkeypatch.setenv("MIDSPAN_CONFIG", str(file))
    assert main(["config", "check"]) == 0
    assert str(file) in capsys.readouterr().out


def test_the_printed_example_schema_and_reference_are_current(capsys: pytest.CaptureFixture[str]) -> None:
    main(["config", "example"])
    assert loads(capsys.readouterr().out) == Config()
    main(["config", "schema"])
    assert capsys.readouterr().out == generate.schema()
    main(["config", "reference"])
    assert capsys.readouterr().out == generate.reference()


def test_migrate_writes_the_file_and_keeps_a_copy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "old.yaml"
    text = "# robot\nros2:\n  build: true # long ago\n"
    file.write_text(text)
    file.chmod(0o640)
    assert main(["config", "migrate", str(file), "--print"]) == 0
    captured = capsys.readouterr()
    assert captured.out == "# robot\nversion: 1\nros2:\n  # build: true # long ago\n"
    assert "ros2.build was removed" in captured.err
    assert file.read_text() == text
    assert main(["config", "migrate", str(file)]) == 0
    assert (file.read_text(), (tmp_path / "old.yaml.old").read_text()) == (captured.out, text)
    assert file.stat().st_mode & 0o777 == 0o640
    assert "the former text is kept in" in capsys.readouterr().out
    assert main(["config", "migrate", str(file)]) == 0
    assert capsys.readouterr().out == f"{file}: already has the current format\n"
    file.write_text(text)
    assert main(["config", "migrate", str(file)]) == 1
    assert "already exists" in capsys.readouterr().err
    assert file.read_text() == text


def test_migrate_reports_what_remains_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "old.yaml"
    file.write_text("hub: {listen: tcp/0.0.0.0:7447}\n")
    assert main(["config", "migrate", str(file)]) == 3
    errors = capsys.readouterr().err
    assert "moved hub.listen to hub.open.listen" in errors
    assert f"{file}:1:15: hub.listen: no longer decides who may send commands" in errors
    assert "has no TLS" in errors
    file.write_text("version: 7\n")
    assert main(["config", "migrate", str(file)]) == 1
    assert "update Midspan" in capsys.readouterr().err
