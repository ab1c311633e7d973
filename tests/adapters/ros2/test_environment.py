"""The environment of a ros2 worker."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from bridge.adapters.ros2 import environment
from bridge.adapters.ros2.environment import available, worker_environment
from bridge.config.model import Config

SITE = f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"


def config(**ros2: object) -> Config:
    return Config.model_validate({"ros2": ros2})


def test_rclpy_is_available_here() -> None:
    assert available(Config()) == ""


def test_missing_rclpy_is_reported_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "find_spec", lambda _name: None)
    assert "rclpy is not installed" in available(Config())
    assert "pip install" in available(Config())


@pytest.mark.parametrize(
    ("configured", "environ", "domain"),
    [
        (7, {"ROS_DOMAIN_ID": "3"}, "7"),
        (None, {"ROS_DOMAIN_ID": "3"}, "3"),
        (None, {}, "0"),
        (None, {"ROS_DOMAIN_ID": ""}, "0"),
    ],
)
def test_domain(configured: int | None, environ: dict[str, str], domain: str) -> None:
    assert worker_environment(config(domain=configured), environ)["ROS_DOMAIN_ID"] == domain


def test_variables_that_would_override_the_profile_are_removed() -> None:
    given = {"ROS_LOCALHOST_ONLY": "1", "FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA", "HOME": "/home/robot"}
    result = worker_environment(Config(), given)
    assert "ROS_LOCALHOST_ONLY" not in result
    assert "FASTDDS_BUILTIN_TRANSPORTS" not in result
    assert result["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
    assert result["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
    assert result["HOME"] == "/home/robot"


def test_ros1_packages_are_removed_from_the_path(tmp_path: Path) -> None:
    (tmp_path / "noetic" / "rospy").mkdir(parents=True)
    (tmp_path / "mine").mkdir()
    result = worker_environment(Config(), {"PYTHONPATH": f"{tmp_path / 'noetic'}:{tmp_path / 'mine'}"})
    assert result["PYTHONPATH"] == str(tmp_path / "mine")
    assert "PYTHONPATH" not in worker_environment(Config(), {"PYTHONPATH": str(tmp_path / "noetic")})


def test_a_sourced_ros2_is_kept(tmp_path: Path) -> None:
    (tmp_path / SITE / "rclpy").mkdir(parents=True)
    given = {
        "AMENT_PREFIX_PATH": str(tmp_path),
        "LD_LIBRARY_PATH": f"{tmp_path}/lib",
        "PYTHONPATH": str(tmp_path / SITE),
    }
    result = worker_environment(Config(), given)
    assert {name: result[name] for name in given} == given


def test_installed_but_unsourced_ros2_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / SITE / "rclpy").mkdir(parents=True)
    monkeypatch.setattr(environment, "_SYSTEM", tmp_path)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "bare"))
    result = worker_environment(Config(), {})
    assert result["PYTHONPATH"] == str(tmp_path / SITE)
    assert result["LD_LIBRARY_PATH"] == str(tmp_path / "lib")
    assert result["AMENT_PREFIX_PATH"] == str(tmp_path)
