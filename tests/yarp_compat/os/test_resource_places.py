"""YARP's folders on each system (values as in yarp/conf/tests/dirs.cpp)."""

from __future__ import annotations

import pytest

import yarp_compat as yarp
from yarp_compat.naming.directories import Directories


def test_linux_has_the_default_folders_of_yarp() -> None:
    folders = Directories({"HOME": "/home/r1"}, "linux")
    assert folders.data_home() == "/home/r1/.local/share/yarp"
    assert folders.config_home() == "/home/r1/.config/yarp"
    assert folders.data_dirs() == ["/usr/local/share/yarp", "/usr/share/yarp"]
    assert folders.config_dirs() == ["/etc/xdg/yarp"]
    assert folders.robot() == "default"


def test_variables_have_priority() -> None:
    folders = Directories(
        {
            "HOME": "/home/r1", "XDG_DATA_HOME": "/x", "XDG_DATA_DIRS": "/p:/q", "YARP_CONFIG_DIRS": "/a:/b",
            "YARP_CONFIG_HOME": "/c", "YARP_ROBOT_NAME": "SIM_CER",
        },
        "linux",
    )  # fmt: skip
    assert folders.data_home() == "/x/yarp"
    assert folders.data_dirs() == ["/p/yarp", "/q/yarp"]
    assert folders.config_dirs() == ["/a", "/b"]
    assert folders.config_home() == "/c"
    assert folders.robot() == "SIM_CER"


@pytest.mark.parametrize(
    ("platform", "environment", "data", "dirs"),
    [
        ("darwin", {"HOME": "/Users/a"}, "/Users/a/Library/Application Support/yarp", "/usr/local/share/yarp"),
        ("win32", {"APPDATA": "C:/a"}, "C:/a\\yarp", "C:\\ProgramData\\yarp"),
        ("win32", {"APPDATA": "C:/a", "YARP_DATA_DIRS": "C:/d;D:/e", "YARP_DATA_HOME": "C:/h"}, "C:/h", "C:/d"),
    ],
)
def test_macos_and_windows_have_their_own_folders(
    platform: str, environment: dict[str, str], data: str, dirs: str
) -> None:
    folders = Directories(environment, platform)
    assert folders.data_home() == data
    assert folders.data_dirs()[0] == dirs


def test_empty_variable_counts_as_set() -> None:
    folders = Directories({"HOME": "/h", "YARP_DATA_HOME": "", "YARP_DATA_DIRS": ""}, "linux")
    assert (folders.data_home(), folders.data_dirs()) == ("", [])


def test_functions_of_the_bindings_return_folders_and_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("YARP_CACHE_HOME", "XDG_CACHE_HOME", "YARP_RUNTIME_DIR", "XDG_RUNTIME_DIR", "TMPDIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", "/h")
    monkeypatch.setenv("USER", "u")
    monkeypatch.setenv("A_PATH", "/a:/b")
    assert (yarp.home(), yarp.cachehome(), yarp.yarpcachehome()) == ("/h", "/h/.cache", "/h/.cache/yarp")
    assert (yarp.tempdir(), yarp.yarpruntimedir()) == ("/tmp", "/tmp/runtime-u/yarp")
    assert yarp.get_string("NOT_THERE", "x") == "x"
    assert yarp.get_string("NOT_THERE", "A_PATH", "", "+") == "/a:/b+"
    assert yarp.get_path("A_PATH") == ("/a", "/b")
    assert yarp.get_path("NOT_THERE", "A_PATH", "", "/yarp") == ("/a/yarp", "/b/yarp")
    assert yarp.set_bool("A_FLAG", True)
    assert yarp.get_bool("A_FLAG")
    assert yarp.is_set("A_FLAG")
    assert yarp.unset("A_FLAG")
    assert not yarp.get_bool("A_FLAG")
