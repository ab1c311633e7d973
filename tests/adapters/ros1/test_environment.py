"""The environment of the ros1 worker."""

import os
import sys

import pytest

from bridge.adapters.ros1.environment import available, is_local, worker_environment
from bridge.config.model import Config
from bridge.config.sections.ros import Ros1Section
from bridge.messages.definitions.names import ROS1_PACKAGES
from bridge.messages.registry import Registry

GENPY_FILE = '''class Own(genpy.Message):
  _full_text = """int32 own
"""
'''


@pytest.fixture
def noetic(tmp_path):
    """A folder with ROS 1's Python packages, one of which exists nowhere else."""
    folder = tmp_path / "noetic"
    for name in ("rospy", "own_msgs/msg"):
        (folder / name).mkdir(parents=True)
    (folder / "own_msgs" / "msg" / "_Own.py").write_text(GENPY_FILE)
    return folder


def on(packages):
    return Config(ros1=Ros1Section(packages=packages))


def test_packages_of_a_sourced_ros_2_do_not_shadow_the_workers_libraries(tmp_path, noetic):
    """ROS 2's packages, and the neighbors of ROS 1's packages, must not shadow Midspan's libraries."""
    jazzy, work = tmp_path / "jazzy", tmp_path / "work"
    (jazzy / "rclpy").mkdir(parents=True)
    path = os.pathsep.join(map(str, [jazzy, noetic, work]))
    libraries = os.pathsep.join([f"{sys.prefix}/lib", "/opt/robot/lib"])
    env = worker_environment(
        Config(), {"PYTHONPATH": path, "LD_LIBRARY_PATH": libraries, "ROS_DISTRO": "jazzy", "PATH": "/bin"}
    )
    assert env["PYTHONPATH"] == str(work)
    assert env[ROS1_PACKAGES] == str(noetic)
    assert env["LD_LIBRARY_PATH"] == "/opt/robot/lib"
    assert env["PATH"] == "/bin"
    assert "ROS_DISTRO" not in env
    bare = worker_environment(Config(), {"LD_LIBRARY_PATH": f"{sys.prefix}/lib", "PYTHONPATH": str(jazzy)})
    assert not {"LD_LIBRARY_PATH", "PYTHONPATH", ROS1_PACKAGES} & bare.keys()


def test_definitions_come_from_the_configured_folder(monkeypatch, noetic, tmp_path):
    env = worker_environment(on(noetic), {"PYTHONPATH": str(tmp_path / "work")})
    assert (env[ROS1_PACKAGES], env["PYTHONPATH"]) == (str(noetic), str(tmp_path / "work"))
    monkeypatch.setenv(ROS1_PACKAGES, env[ROS1_PACKAGES])
    assert "int32 own" in Registry().ros1("own_msgs/Own").definition


def test_the_side_is_always_available(tmp_path):
    assert available(Config()) == ""
    assert available(on(tmp_path)) == ""
    assert "ros1.packages" in available(on(tmp_path / "missing"))
    with pytest.raises(RuntimeError, match=r"ros1\.packages: .*/missing is not a folder"):
        worker_environment(on(tmp_path / "missing"), {})


ADDRESSES = [
    ({}, {}, {"ROS_MASTER_URI": "http://localhost:11311", "ROS_IP": "127.0.0.1"}),
    ({}, {"ROS_MASTER_URI": "http://127.0.0.1:5/"}, {"ROS_IP": "127.0.0.1"}),
    ({}, {"ROS_MASTER_URI": "http://robot.invalid:11311"}, {"ROS_IP": None, "ROS_HOSTNAME": None}),
    ({}, {"ROS_IPV6": "on"}, {"ROS_HOSTNAME": "localhost", "ROS_IP": "127.0.0.1"}),
    ({}, {"ROS_IPV6": "on", "ROS_IP": "::1"}, {"ROS_HOSTNAME": None, "ROS_IP": "::1"}),
    ({}, {"ROS_IP": "10.0.0.2"}, {"ROS_IP": "10.0.0.2", "ROS_HOSTNAME": None}),
    ({}, {"ROS_HOSTNAME": "me"}, {"ROS_HOSTNAME": "me", "ROS_IP": None}),
    ({"master": "http://10.0.0.1:11311"}, {}, {"ROS_MASTER_URI": "http://10.0.0.1:11311", "ROS_IP": None}),
    ({"ip": "10.0.0.3"}, {"ROS_HOSTNAME": "me", "ROS_IP": "10.0.0.2"}, {"ROS_IP": "10.0.0.3", "ROS_HOSTNAME": None}),
    ({"hostname": "you"}, {"ROS_IP": "10.0.0.2"}, {"ROS_HOSTNAME": "you", "ROS_IP": None}),
]


@pytest.mark.parametrize(("configured", "environ", "expected"), ADDRESSES)
def test_the_configured_address_overrides_the_environment(configured, environ, expected):
    env = worker_environment(Config(ros1=Ros1Section(**configured)), environ)
    assert {name: env.get(name) for name in expected} == expected


def test_which_masters_are_local(monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "robot")
    addresses = {"robot": ["127.0.1.1"]}
    monkeypatch.setattr("socket.getaddrinfo", lambda host, _port: [(0, 0, 0, "", (a, 0)) for a in addresses[host]])
    for host in ("localhost", "127.0.0.1", "127.1.2.3", "::1", "robot"):
        assert is_local(host), host
    addresses["robot"] = ["127.0.1.1", "192.168.1.2"]
    for host in ("192.168.1.2", "robot", "other", ""):
        assert not is_local(host), host
