"""YARP's folders on each system (values of yarp/conf/tests/dirs.cpp's kind)."""

from __future__ import annotations

from pathlib import Path

import pytest

from yarp_compat.os.resource_places import Directories


def test_linux_defaults() -> None:
    found = Directories({"HOME": "/home/r1"}, "linux")
    assert found.data_home() == Path("/home/r1/.local/share/yarp")
    assert found.config_home() == Path("/home/r1/.config/yarp")
    assert found.data_dirs() == [Path("/usr/local/share/yarp"), Path("/usr/share/yarp")]
    assert found.config_dirs() == [Path("/etc/xdg/yarp")]
    assert found.robot() == "default"


def test_variables_outrank() -> None:
    found = Directories(
        {
            "HOME": "/home/r1", "XDG_DATA_HOME": "/x", "XDG_DATA_DIRS": "/p:/q", "YARP_CONFIG_DIRS": "/a:/b",
            "YARP_CONFIG_HOME": "/c", "YARP_ROBOT_NAME": "SIM_CER",
        },
        "linux",
    )  # fmt: skip
    assert found.data_home() == Path("/x/yarp")
    assert found.data_dirs() == [Path("/p/yarp"), Path("/q/yarp")]
    assert found.config_dirs() == [Path("/a"), Path("/b")]
    assert found.config_home() == Path("/c")
    assert found.robot() == "SIM_CER"


@pytest.mark.parametrize(
    ("platform", "environment", "data", "dirs"),
    [
        ("darwin", {"HOME": "/Users/a"}, "/Users/a/Library/Application Support/yarp", "/usr/local/share/yarp"),
        ("win32", {"APPDATA": "C:/a"}, "C:/a/yarp", "C:\\ProgramData/yarp"),
        ("win32", {"APPDATA": "C:/a", "YARP_DATA_DIRS": "C:/d;D:/e", "YARP_DATA_HOME": "C:/h"}, "C:/h", "C:/d"),
    ],
)
def test_other_systems(platform: str, environment: dict[str, str], data: str, dirs: str) -> None:
    found = Directories(environment, platform)
    assert found.data_home() == Path(data)
    assert found.data_dirs()[0] == Path(dirs)
