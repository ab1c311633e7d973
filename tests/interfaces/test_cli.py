"""The command `midspan interfaces`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from bridge.cli.main import main
from bridge.interfaces import bundled_packages
from bridge.interfaces.cache import SITE, environment, link_into_venv
from bridge.messages.registry import Registry
from tests.support.missing import COMPILER, needs


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with two packages: one with msg/, one with .msg files in the folder itself."""
    for file in ("workspace/midspan_one_msgs/msg/One.msg", "workspace/midspan_two_msgs/Two.msg"):
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).write_text("int8 value\n", encoding="utf-8")
    return tmp_path / "workspace"


@needs(COMPILER)
def test_interfaces_are_built_once_and_listed(folder: Path, cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["interfaces", "build", str(folder), "--cache", str(cache), "--json"]) == 0
    printed = capsys.readouterr()
    assert "midspan_one_msgs: built" in printed.err
    result = json.loads(printed.out)
    assert result["packages"] == ["midspan_one_msgs", "midspan_two_msgs"]
    assert (Path(result["prefix"]) / SITE / "midspan_two_msgs" / "msg" / "_two.py").is_file()
    assert main(["interfaces", "build", str(folder), "--cache", str(cache)]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    assert f"export PYTHONPATH={result['prefix']}/{SITE}" in printed.out
    assert main(["interfaces", "list", "--cache", str(cache), "--json"]) == 0
    states = {(row["package"], row["state"]) for row in json.loads(capsys.readouterr().out)}
    assert {("midspan_one_msgs", "built"), ("std_msgs", "installed")} <= states
    assert set(bundled_packages()) <= {package for package, _ in states}


TEXTS = {
    "msg/Greet.msg": r'string greeting "call \"hi\" and \"bye\""' + "\n",
    "msg/Umlaut.msg": 'string greeting "grüß  dich_"\nstring NAME=日本\nwstring wide "é😀"\n',
    "msg/Words.msg": r"""string[] words ["call \"hi\"", 'it\'s', "grüß, dich", plain]""" + "\n",
    "srv/Ask.srv": "string query \"a=b\"\n------\nstring<=9 reply 'it\\'s'\n",
}
SHOW = """
from renamed_msgs.msg import Greet, Umlaut, Words
from renamed_msgs.srv import Ask
print([Greet().greeting, Umlaut().greeting, Umlaut.NAME, Umlaut().wide, Words().words, Ask.Request().query,
       Ask.Response().reply])
"""


@needs(COMPILER)
def test_unusual_strings_survive_the_build_of_a_packages_folder(
    tmp_path: Path, cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The package gets its name from package.xml, not from the folder."""
    folder = tmp_path / "checkout-main"
    for path, text in TEXTS.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")
    (folder / "package.xml").write_text('<package format="3"><name>renamed_msgs</name></package>')
    assert main(["interfaces", "build", str(folder), "--cache", str(cache), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["packages"] == ["renamed_msgs"]
    env = os.environ | environment([Path(result["prefix"])])
    done = subprocess.run(
        [sys.executable, "-c", SHOW], env=env, capture_output=True, text=True, check=False, timeout=60
    )
    strings = ['call "hi"', "it's", "grüß, dich", "plain"]
    values = ['call "hi" and "bye"', "grüß  dich_", "日本", "é😀", strings, "a=b", "it's"]
    assert done.stdout == f"{values}\n", done.stderr
    share = Path(result["prefix"]) / "share" / "renamed_msgs"
    assert (share / "srv" / "Ask.srv").read_text().splitlines()[1] == "---"
    assert (share / "msg" / "Greet.msg").read_text() == TEXTS["msg/Greet.msg"]
    registry = Registry(folders=[folder.parent], prefixes=[Path(result["prefix"])])
    assert registry.schema("renamed_msgs/msg/Words").root.fields[0].default == tuple(strings)
    assert registry.schema("renamed_msgs/msg/Greet").root.fields[0].default == values[0]


def test_an_error_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "midspan_one_msgs/msg/One.msg").write_text("in8 value\n", encoding="utf-8")
    assert main(["interfaces", "build", str(folder)]) == 1
    assert capsys.readouterr().err.startswith("midspan: midspan_one_msgs/msg/One.msg:1: unknown type 'in8'")


def test_an_empty_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["interfaces", "build", str(tmp_path)]) == 1
    assert "no .msg, .srv or .action files" in capsys.readouterr().err


@pytest.mark.thorough
def test_a_prefix_is_linked_into_the_virtual_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prefix = tmp_path / "prefix"  # its contents do not matter
    monkeypatch.setattr(sysconfig, "get_path", lambda _name: str(tmp_path))
    file = link_into_venv(prefix)
    assert file is not None
    assert file.parent == tmp_path
    assert file.read_text(encoding="utf-8") == f"{prefix / SITE}\n"
    monkeypatch.setattr(sys, "base_prefix", sys.prefix)
    assert link_into_venv(prefix) is None
