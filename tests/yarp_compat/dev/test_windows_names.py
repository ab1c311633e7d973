"""Maps' names as names of files on Windows: none that its rules forbid, judged by Python's own words for them."""

from __future__ import annotations

import warnings
from pathlib import PureWindowsPath

import pytest

from yarp_compat.dev.mapfile import MapFileError, file_name


def legal(name: str) -> bool:
    """What `pathlib` and Microsoft's rules say of a file beside others in a folder."""
    path = PureWindowsPath("C:/maps") / f"{name}.map"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        reserved = path.is_reserved()
    inside = path.parent == PureWindowsPath("C:/maps") and path.name == f"{name}.map"
    return inside and not reserved and not set(name) & set('<>:"|?*') and name == name.rstrip(". ")


@pytest.mark.parametrize(
    "name",
    [
        "CON", "con", "aux", "NUL", "prn", "COM1", "lpt9", "con.b", "COM\u00b9", "CON ", "floor.", "floor ", "a:b",
        "C:", "C:x", "a?b", "a*b", 'a"b', "a<b", "a>b", "a|b",
    ],
)  # fmt: skip
def test_what_windows_forbids_is_refused_there_alone(name: str) -> None:
    assert not legal(name)
    with pytest.raises(MapFileError, match="on Windows"):
        file_name(name, windows=True)
    assert file_name(name, windows=False) == name


@pytest.mark.parametrize(
    "name", ["floor 2", "console", "COM", "COM10", "lpt", "nullable", "a.con", "1.5", "K\u00fcche"]
)
def test_what_windows_allows_is_allowed(name: str) -> None:
    assert legal(name)
    assert file_name(name, windows=True) == name


@pytest.mark.parametrize("name", ["", ".hidden", "a/b", "a\\b", "a\nb"])
@pytest.mark.parametrize("windows", [True, False])
def test_what_no_system_allows(name: str, windows: bool) -> None:
    with pytest.raises(MapFileError):
        file_name(name, windows=windows)
