"""`midspan interfaces` as a person calls it."""

from __future__ import annotations

import json
import sys
import sysconfig
from pathlib import Path

import pytest

from bridge.cli.main import main
from bridge.interfaces import bundled_packages
from bridge.interfaces.cache import SITE, link_into_venv
from tests.support.missing import COMPILER, needs


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of packages: one with msg/, one with .msg files in the folder itself."""
    for file in ("workspace/midspan_one_msgs/msg/One.msg", "workspace/midspan_two_msgs/Two.msg"):
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).write_text("int8 value\n", encoding="utf-8")
    return tmp_path / "workspace"


@needs(COMPILER)
def test_build_and_list(folder: Path, cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["interfaces", "build", str(folder), "--cache", str(cache), "--json"]) == 0
    told = capsys.readouterr()
    assert "midspan_one_msgs: built" in told.err
    result = json.loads(told.out)
    assert result["packages"] == ["midspan_one_msgs", "midspan_two_msgs"]
    assert (Path(result["prefix"]) / SITE / "midspan_two_msgs" / "msg" / "_two.py").is_file()
    assert main(["interfaces", "build", str(folder), "--cache", str(cache)]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert f"export PYTHONPATH={result['prefix']}/{SITE}" in told.out
    assert main(["interfaces", "list", "--cache", str(cache), "--json"]) == 0
    states = {(row["package"], row["state"]) for row in json.loads(capsys.readouterr().out)}
    assert {("midspan_one_msgs", "built"), ("std_msgs", "installed")} <= states
    assert set(bundled_packages()) <= {package for package, _ in states}


def test_a_fault_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "midspan_one_msgs/msg/One.msg").write_text("in8 value\n", encoding="utf-8")
    assert main(["interfaces", "build", str(folder)]) == 1
    assert capsys.readouterr().err.startswith("midspan: midspan_one_msgs/msg/One.msg:1: unknown type 'in8'")


def test_an_empty_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["interfaces", "build", str(tmp_path)]) == 1
    assert "no .msg, .srv or .action files" in capsys.readouterr().err


@pytest.mark.thorough
def test_a_prefix_is_linked_into_the_virtual_environment(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sysconfig, "get_path", lambda _name: str(tmp_path))
    file = link_into_venv(built)
    assert file is not None
    assert file.parent == tmp_path
    assert file.read_text(encoding="utf-8") == f"{built / SITE}\n"
    monkeypatch.setattr(sys, "base_prefix", sys.prefix)
    assert link_into_venv(built) is None
