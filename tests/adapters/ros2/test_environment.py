"""The environment of a ros2 worker."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from pydantic import ValidationError

from bridge.adapters.ros2 import environment
from bridge.adapters.ros2.environment import available, worker_environment
from bridge.adapters.ros2.releases import release_of
from bridge.config.model import Config

SITE = f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"


def config(**ros2: object) -> Config:
    return Config.model_validate({"ros2": ros2})


def install(prefix: Path, version: str, site: str = SITE) -> Path:
    """Create what a ROS 2 with this version of rclpy has in its prefix."""
    for folder in (f"{site}/rclpy", "share/rclpy"):
        (prefix / folder).mkdir(parents=True)
    (prefix / "share/rclpy/package.xml").write_text(f"<package><version>{version}</version></package>\n")
    return prefix


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without wheels and without /opt/ros."""
    monkeypatch.setattr(environment, "_SYSTEM", tmp_path / "none")
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "bare"))
    return tmp_path


def test_rclpy_is_available_here() -> None:
    assert available(Config()) == ""


def test_missing_rclpy_is_reported_with_its_cure(monkeypatch: pytest.MonkeyPatch, bare: Path) -> None:
    monkeypatch.setattr(environment, "find_spec", lambda _name: None)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(bare))
    assert "rclpy is not installed" in available(Config())
    assert "pip install" in available(Config())


def test_a_release_for_another_python_is_refused_with_the_cure(monkeypatch: pytest.MonkeyPatch, bare: Path) -> None:
    """ROS 2 Humble is sourced."""
    humble = install(bare / "humble", "3.3.20", site="local/lib/python3.10/dist-packages")
    monkeypatch.setattr(environment, "find_spec", lambda _name: None)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(humble))
    text = available(Config())
    assert f"the sourced ROS 2 in {humble} is not for Midspan's Python" in text
    assert "pip install" in text
    assert "kilted (Python 3.12)" in text
    assert "reached over the network" in text


CYCLONE = {"rmw": "rmw_cyclonedds_cpp"}


def test_cyclone_dds_needs_its_library(monkeypatch: pytest.MonkeyPatch, bare: Path) -> None:
    prefix = install(bare / "jazzy", "7.1.6")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    monkeypatch.delenv("ROS_SECURITY_ENABLE", raising=False)
    missing = available(config(**CYCLONE))
    assert f"librmw_cyclonedds_cpp.so is not in the ROS 2 in {prefix}" in missing
    assert "install ros-jazzy-rmw-cyclonedds-cpp" in missing
    (prefix / "lib/librmw_cyclonedds_cpp.so").touch()
    assert available(config(**CYCLONE)) == ""
    result = worker_environment(config(**CYCLONE), os.environ)
    assert result["RMW_IMPLEMENTATION"] == "rmw_cyclonedds_cpp"
    assert result.get("LD_PRELOAD") == os.environ.get("LD_PRELOAD")


def test_cyclone_dds_in_a_secured_domain_is_refused(monkeypatch: pytest.MonkeyPatch, bare: Path) -> None:
    """The enclave marks what Midspan creates, so it cannot be an enclave of a keystore."""
    prefix = install(bare / "jazzy", "7.1.6")
    (prefix / "lib/librmw_cyclonedds_cpp.so").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    assert "unset ROS_SECURITY_ENABLE" in available(config(**CYCLONE))


@pytest.mark.parametrize("key", [{"profile": "fastdds.xml"}, {"transport": "shared_memory"}])
def test_settings_of_fast_dds_are_refused_with_cyclone_dds(key: dict[str, str]) -> None:
    with pytest.raises(ValidationError, match="is for Fast DDS"):
        config(**CYCLONE, **key)


def test_an_unknown_release_is_refused(monkeypatch: pytest.MonkeyPatch, bare: Path) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(install(bare / "iron", "4.1.7")))
    assert f"the ROS 2 in {bare / 'iron'} is none of jazzy" in available(Config())


@pytest.mark.parametrize(("version", "name"), [("7.1.6", "jazzy"), ("9.1.2", "kilted"), ("10.0.10", "lyrical")])
def test_a_release_is_recognized(monkeypatch: pytest.MonkeyPatch, bare: Path, version: str, name: str) -> None:
    prefix = install(bare / "any", version)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    assert available(Config()) == ""
    release = release_of(prefix)
    assert release is not None
    assert release.name == name


def test_the_wheels_are_used_beside_a_sourced_release_for_another_python(tmp_path: Path) -> None:
    """Otherwise rclpy of Humble would be imported, for which Midspan's Python has no library."""
    humble = install(tmp_path / "humble", "3.3.20", site="lib/python3.10/site-packages")
    given = {
        "AMENT_PREFIX_PATH": str(humble),
        "PYTHONPATH": f"{humble}/lib/python3.10/site-packages{os.pathsep}/mine",
        "LD_LIBRARY_PATH": f"{humble}/lib",
    }
    result = worker_environment(Config(), given)
    assert result["PYTHONPATH"] == "/mine"
    assert str(humble) not in result["LD_LIBRARY_PATH"]
    assert result["LD_LIBRARY_PATH"].startswith(f"{sys.prefix}/lib")


@pytest.mark.parametrize(
    ("configured", "environ", "domain"),
    [
        (7, {"ROS_DOMAIN_ID": "3"}, "7"),
        (None, {"ROS_DOMAIN_ID": "3"}, "3"),
        (None, {}, "0"),
        (None, {"ROS_DOMAIN_ID": ""}, "0"),
    ],
)
def test_the_configured_domain_overrides_the_environment(
    configured: int | None, environ: dict[str, str], domain: str
) -> None:
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


def test_installed_but_unsourced_ros2_is_found(bare: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prefix = install(bare / "kilted", "9.1.2")
    monkeypatch.setattr(environment, "_SYSTEM", bare)
    result = worker_environment(Config(), {})
    assert result["PYTHONPATH"] == str(prefix / SITE)
    assert result["LD_LIBRARY_PATH"] == str(prefix / "lib")
    assert result["AMENT_PREFIX_PATH"] == str(prefix)
