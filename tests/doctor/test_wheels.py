"""The doctor names requirements that have no wheel on a system."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from bridge.daemon.workers import WorkerKind
from bridge.doctor.check import Result
from bridge.doctor.checks import machine
from tests.doctor.parts import around, only

WINDOWS = {"sys_platform": "win32", "platform_machine": "AMD64"}
LINUX = {"sys_platform": "linux", "platform_machine": "x86_64"}
DART = ["dartpy"]
ROS2 = ["ros-jazzy-rclpy", "ros-jazzy-common-interfaces"]


@pytest.fixture
def requirements() -> list[str]:
    """Return Midspan's own requirements, as in the metadata of its wheel."""
    file = Path(__file__).parents[2] / "pyproject.toml"
    project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
    requirements_text: list[str] = list(project["dependencies"])
    for extra, texts in project["optional-dependencies"].items():
        for text in texts:
            name, _, marker = text.partition(" ; ")
            requirements_text.append(
                f"{name} ; " + (f'({marker}) and extra == "{extra}"' if marker else f'extra == "{extra}"')
            )
    return requirements_text


def test_nothing_is_left_out_on_linux(requirements: list[str]) -> None:
    assert machine.left_out(requirements, LINUX) == {}
    assert only(machine.compare(around(), requirements, LINUX)).result is Result.OK


@pytest.mark.parametrize("system", [WINDOWS, {"sys_platform": "darwin", "platform_machine": "arm64"}])
def test_other_systems_lack_ros2_and_dart(requirements: list[str], system: dict[str, str]) -> None:
    assert machine.left_out(requirements, system) == {"ros2": ROS2, "sim": DART}


def test_another_processor_lacks_ros2(requirements: list[str]) -> None:
    assert machine.left_out(requirements, {**LINUX, "platform_machine": "aarch64"}) == {"ros2": ROS2}


def test_a_newer_python_lacks_dart(requirements: list[str]) -> None:
    assert machine.left_out(requirements, {**LINUX, "python_version": "3.14"}) == {"sim": DART}


@pytest.mark.parametrize(
    ("enabled", "missing", "result"),
    [
        ("auto", "no rclpy", Result.WARN),
        (True, "no rclpy", Result.FAIL),
        ("auto", "", Result.OK),  # with an installed ROS 2
        (False, "no rclpy", Result.OK),
    ],
)
def test_a_side_without_wheels_is_named(
    requirements: list[str], enabled: Any, missing: str, result: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(WorkerKind, "missing", lambda *_: missing)
    finding = only(machine.compare(around({"ros2": {"enabled": enabled}}), requirements, WINDOWS))
    assert finding.result is result
    if result in (Result.WARN, Result.FAIL):
        start = f"no wheel on this system (win32, AMD64): {', '.join(ROS2)}; so side ros2 is not available"
        assert finding.seen == start
        assert "midspan worker ros2" in finding.cure
