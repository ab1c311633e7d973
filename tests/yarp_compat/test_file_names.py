"""Names of files on Windows: our rules agree with Python's."""

from __future__ import annotations

import sys
from urllib.parse import unquote

import pytest

from tests.support.hidden import is_windows_name
from yarp_compat.file_names import escaped, forbidden

FORBIDDEN = [
    "CON", "con", "aux", "NUL", "prn", "COM1", "lpt9", "con.b", "CON.daemon.lock", "COM\u00b9", "CON ", "conin$",
    "floor.", "floor ", "robot. .", "a:b", "C:", "C:x", "a?b", "a*b", 'a"b', "a<b", "a>b", "a|b",
    "a\nb", "floor\n", "\ta", "a\x01", "a\x1fb", "floor.\n",
]  # fmt: skip


@pytest.mark.parametrize("name", FORBIDDEN)
def test_names_forbidden_by_windows_are_forbidden_only_there(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (forbidden(name), escaped(name)) == ("", name)
    monkeypatch.setattr(sys, "platform", "win32")
    assert not is_windows_name(name)
    assert "on Windows" in forbidden(name)
    assert is_windows_name(escaped(name))
    assert unquote(escaped(name)) == name, "different names have different files"


@pytest.mark.parametrize(
    "name", ["floor 2", "console", "COM", "COM10", "lpt", "nullable", "a.con", ".con", "1.5", "K\u00fcche", "a\x7fb"]
)
def test_names_allowed_by_windows_are_allowed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    assert is_windows_name(name)
    assert (forbidden(name), escaped(name)) == ("", name)
