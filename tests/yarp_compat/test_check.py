"""``python -m yarp_compat --check``: the names of YARP that a script uses, and the missing ones."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.peers.yarp.script import SCRIPTS
from yarp_compat import check
from yarp_compat.script_names import NameUse, names_of

SCRIPT = """\
import yarp as y
from yarp import Bottle as B, IGazeControl

options = y.Property()
options.put("device", "gazecontrollerclient")
driver = y.PolyDriver(options)
gaze = driver.viewIGazeControl()
gaze.lookAtFixationPoint([1, 2, 3])


class Module(y.RFModule):
    def __init__(self):
        self.port = None
        self.port = y.BufferedPortBottle()
        self.other = y.Port()
        self.other = open("x")

    def configure(self, rf):
        port = y.Port()
        port.open("/a")
        port.openFakely()
        rf.check("anything")
        self.port.getEnvelopes()
        self.other.getEnvelopes()
        y.Network.conect("/a", "/b")
        return y.Botle().size()
"""


def uses(text: str) -> set[tuple[int, str]]:
    return {(use.line, use.name) for use in names_of(ast.parse(text)).uses}


def test_names_methods_and_devices_are_detected() -> None:
    names = names_of(ast.parse(SCRIPT)).uses
    assert NameUse(5, "gazecontrollerclient", is_device=True) in names
    named = {(use.line, use.name) for use in names if not use.is_device}
    assert {
        (2, "Bottle"), (2, "IGazeControl"), (4, "Property"), (5, "Property.put"), (6, "PolyDriver"),
        (7, "PolyDriver.viewIGazeControl"), (8, "IGazeControl.lookAtFixationPoint"), (11, "RFModule"),
        (20, "Port.open"), (21, "Port.openFakely"), (23, "BufferedPortBottle.getEnvelopes"), (25, "Network.conect"),
        (26, "Botle"),
    } <= named  # fmt: skip
    assert not {line for line, _ in named} & {22, 24}, "variables with several classes, or an unknown one, are ignored"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("import os\nos.getcwd()", set()),
        ("import yarp\nx = yarp\nprint(x)", set()),
        ("import yarp_compat as yarp\nyarp.Network.init()", {(2, "Network"), (2, "Network.init")}),
        ("from yarp import *\nb = Bottle()\nb.get(0)\nprint(b, here)", {(2, "Bottle"), (3, "Bottle.get"), (4, "here")}),
        ("import yarp\nyarp.Bottle = 3", set()),
        ("import yarp\nwith yarp.Port() as p:\n    p.open('/a')", {(2, "Port"), (3, "Port.open")}),
        ("import yarp\na, b = yarp.Port(), 1\na.open('/a')\nb.open()", {(2, "Port"), (3, "Port.open")}),
        ("import yarp\np = yarp.Port()\ndef f(p):\n    p.shut()", {(2, "Port")}),
        ("import yarp\np = yarp.Port()\ndef f():\n    p.shut()", {(2, "Port"), (4, "Port.shut")}),
        ("import yarp\nfor p in ps:\n    p.shut()\np = yarp.Port()", {(4, "Port")}),
        ("import yarp\nd = yarp.PolyDriver('(device usb)')", {(2, "PolyDriver"), (2, "usb"), (2, "(device usb)")}),
    ],
)
def test_uses_of_the_bindings_in_a_script_are_listed(text: str, expected: set[tuple[int, str]]) -> None:
    assert uses(text) == expected


def test_missing_names_are_listed_with_their_lines(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    checked = check.check(script)
    assert {entry.name: entry.lines for entry in checked.missing} == {
        "IGazeControl": [2, 8],
        "device gazecontrollerclient": [5],
        "Port.openFakely": [21],
        "BufferedPortBottle.getEnvelopes": [23],
        "Network.conect": [25],
        "Botle": [26],
    }
    text = str(checked)
    assert "  IGazeControl (lines 2, 8): no such devices here: use the controller's rpc port with RpcClient" in text
    assert "  Botle (line 26): did you mean 'Bottle'?" in text
    assert "  BufferedPortBottle.getEnvelopes (line 23): did you mean 'getEnvelope'?" in text
    assert "  Network.conect (line 25): did you mean 'connect'?" in text
    assert text.splitlines()[0] == f"{script}: 18 names of YARP, 6 missing"


def test_no_name_is_missing_in_the_scripts_that_run() -> None:
    for path in SCRIPTS.glob("*.py"):
        checked = check.check(path)
        assert checked.imports_yarp
        assert not checked.missing, str(checked)


@pytest.mark.parametrize(
    ("content", "error"),
    [
        (b"import yarp\nprint 'hello'\n", "bad.py:2: this is Python 2"),
        (b"import yarp\ntry:\n    pass\nexcept Exception, e:\n    pass\n", "bad.py:4: this is Python 2"),
        (b"import yarp\nraise ValueError, 'no'\n", "bad.py:2: this is Python 2"),
        (b"import yarp\nx = 0777\n", "bad.py:2: this is Python 2"),
        (b'import yarp\n""" print \'x\' """\nx = = 3\n', "bad.py:3: not valid Python: invalid syntax"),
        (b"# YARP\n\nYARP is a library\n", "bad.py:3: not valid Python"),
        (b"\x7fELF\x02\x01\x01\x00\xff\xfe", "bad.py: cannot read it as Python"),
        (b"x = 1\x00\n", "bad.py"),
        (b"# -*- coding: latin-99 -*-\n", "bad.py: cannot read it as Python"),
        (b"(" * 100_000, "not valid Python"),
    ],
)
def test_an_invalid_script_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes, error: str
) -> None:
    (tmp_path / "bad.py").write_bytes(content)
    (tmp_path / "good.py").write_text("import yarp\nyarp.Network.init()\n")
    assert check.main([str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert error in err
    assert "1 script for YARP, 1 with every name" in out, "the other files are checked"


def test_files_and_folders_on_the_command_line_are_checked(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    (folder / "inner").mkdir(parents=True)
    (folder / "inner" / "one.py").write_text("import yarp\nyarp.Network.init()\n")
    (folder / "two.py").write_text("import os\n")
    other, empty = tmp_path / "other", tmp_path / "empty"
    other.write_text("import os\n")
    empty.mkdir()

    def run(*paths: Path | str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "yarp_compat", "--check", *map(str, paths)]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

    done = run(folder, other)
    assert done.returncode == 0, done.stderr
    assert done.stdout == (
        f"{folder / 'inner' / 'one.py'}: 2 names of YARP, none missing\n{other}: it does not import yarp\n"
        "1 script for YARP, 1 with every name\n"
    )
    done = run(empty, tmp_path / "nowhere")
    assert done.returncode == 1
    assert f"{empty}: no Python files in this folder" in done.stderr
    assert f"{tmp_path / 'nowhere'}: file or folder not found" in done.stderr
    assert check.main([]) == 1
    assert check.main(["--chek"]) == 1
