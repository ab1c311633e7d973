"""SROS 2: the enclave of the side, and why it cannot join a secured domain."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from bridge.adapters.ros2 import environment, security
from bridge.adapters.ros2.environment import available, worker_environment
from bridge.config.model import Config
from tests.peers.ros2.network import ros2_environment
from tests.support.missing import ROS2, needs

ON = {"ROS_SECURITY_ENABLE": "true"}


@pytest.mark.parametrize(
    ("environ", "enclave"),
    [
        ({}, None),
        ({"ROS_SECURITY_ENABLE": "false"}, None),
        (ON, "/midspan"),
        (ON | {"ROS_SECURITY_ENCLAVE_OVERRIDE": "/robot/bridge"}, "/robot/bridge"),
    ],
)
def test_the_worker_gets_an_enclave_if_security_is_on(environ: dict[str, str], enclave: str | None) -> None:
    assert worker_environment(Config(), environ).get("ROS_SECURITY_ENCLAVE_OVERRIDE") == enclave


def test_wheels_cannot_join_a_secured_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setattr(environment, "uses_wheels", lambda _environ: True)
    reason = available(Config())
    assert "the Fast DDS of the wheels is built without DDS Security; source an installed ROS 2" in reason


@needs(ROS2)
def test_fast_dds_of_the_wheels_has_no_security(tmp_path: Path) -> None:
    """If this fails, the wheels have DDS Security, and the side can join a secured domain."""
    (tmp_path / "enclaves").mkdir()
    program = "import rclpy; rclpy.init(); rclpy.create_node('secured')"
    env = ros2_environment(**ON, ROS_SECURITY_KEYSTORE=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=False)
    assert done.returncode
    assert "This Fast DDS version doesn't have the security libraries" in done.stderr


def test_an_installed_release_needs_the_enclave(tmp_path: Path) -> None:
    assert "ROS_SECURITY_KEYSTORE is not set" in security.trouble(ON, wheels=False)
    environ = ON | {"ROS_SECURITY_KEYSTORE": str(tmp_path)}
    cure = f"'ros2 security create_enclave {tmp_path} /midspan'"
    assert security.trouble(environ, wheels=False).endswith(cure)
    (tmp_path / "enclaves/midspan").mkdir(parents=True)
    assert security.trouble(environ, wheels=False) == ""
    assert security.trouble({}, wheels=True) == ""
