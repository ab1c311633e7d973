"""The environment of the ros1 worker."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.adapters.ros1.environment import PLACES, available, is_local, packages_folder, worker_environment
from bridge.config.model import Config
from bridge.config.sections.ros import Ros1Section
from tests.peers.ros1.network import needs_ros1


@pytest.fixture
def packages(tmp_path):
    """A folder like ROS 1's, with entries that must not be linked."""
    folder = tmp_path / "dist-packages"
    for name in ("rospy", "rosgraph", "genpy", "numpy", "yaml", "rosgraph_msgs/msg", "roscpp/srv", "std_msgs/msg"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").touch()
    (folder / "gnupg.py").touch()
    (folder / "netifaces.cpython-27-x86_64-linux-gnu.so").touch()
    (folder / "defusedxml").mkdir()
    return folder


def environment_in(tmp_path, config=None, **environ: str):
    base = {"HOME": str(tmp_path), "PATH": "/usr/bin", **environ}
    return worker_environment(config or Config(), base)


def on(packages, **more: str):
    return Config(ros1=Ros1Section(packages=packages, **more))


def links(env):
    return Path(env["PYTHONPATH"].split(os.pathsep)[0])


def test_only_ros1_packages_are_linked(tmp_path, packages):
    env = environment_in(tmp_path, on(packages))
    assert {p.name for p in links(env).iterdir()} == {
        "rospy", "rosgraph", "genpy", "rosgraph_msgs", "roscpp", "std_msgs", "gnupg.py", "defusedxml"
    }  # fmt: skip
    assert env["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] == "1"


def test_links_follow_the_installed_packages(tmp_path, packages):
    before = links(environment_in(tmp_path, on(packages)))
    assert links(environment_in(tmp_path, on(packages))) == before
    (packages / "my_msgs" / "msg").mkdir(parents=True)
    (packages / "my_msgs" / "msg" / "__init__.py").touch()
    after = links(environment_in(tmp_path, on(packages)))
    assert after != before
    assert (after / "my_msgs" / "msg" / "__init__.py").is_file()
    assert before.is_dir(), "a running worker may still use it"
    old = 1_000_000_000
    os.utime(before, (old, old))
    (packages / "your_msgs" / "srv").mkdir(parents=True)
    (packages / "your_msgs" / "srv" / "__init__.py").touch()
    environment_in(tmp_path, on(packages))
    assert not before.exists(), "it has not been used for long"


def test_the_cache_folder(tmp_path, packages):
    assert links(environment_in(tmp_path, on(packages))).parent == tmp_path / ".cache" / "midspan"
    assert (
        links(environment_in(tmp_path, on(packages), XDG_CACHE_HOME=str(tmp_path / "x"))).parent
        == tmp_path / "x" / "midspan"
    )
    assert links(environment_in(tmp_path, on(packages), CACHE_DIRECTORY=str(tmp_path / "c"))).parent == tmp_path / "c"


def test_paths_of_ros2_and_of_the_wheels_are_removed(tmp_path, packages):
    ros2, work = tmp_path / "jazzy", tmp_path / "devel"
    (ros2 / "rclpy").mkdir(parents=True)
    work.mkdir()
    path = os.pathsep.join([str(ros2), str(work), str(packages)])
    libraries = os.pathsep.join([f"{sys.prefix}/lib", "/opt/robot/lib"])
    env = environment_in(tmp_path, on(packages), PYTHONPATH=path, LD_LIBRARY_PATH=libraries)
    assert env["PYTHONPATH"].split(os.pathsep)[1:] == [str(work)]
    assert env["LD_LIBRARY_PATH"] == "/opt/robot/lib"
    assert "LD_LIBRARY_PATH" not in environment_in(tmp_path, on(packages), LD_LIBRARY_PATH=f"{sys.prefix}/lib")


ADDRESSES = [
    ({}, {}, {"ROS_MASTER_URI": "http://localhost:11311", "ROS_IP": "127.0.0.1"}),
    ({}, {"ROS_MASTER_URI": "http://127.0.0.1:5/"}, {"ROS_IP": "127.0.0.1"}),
    ({}, {"ROS_MASTER_URI": "http://robot.invalid:11311"}, {"ROS_IP": None, "ROS_HOSTNAME": None}),
    ({}, {"ROS_IP": "10.0.0.2"}, {"ROS_IP": "10.0.0.2", "ROS_HOSTNAME": None}),
    ({}, {"ROS_HOSTNAME": "me"}, {"ROS_HOSTNAME": "me", "ROS_IP": None}),
    ({"master": "http://10.0.0.1:11311"}, {}, {"ROS_MASTER_URI": "http://10.0.0.1:11311", "ROS_IP": None}),
    ({"ip": "10.0.0.3"}, {"ROS_HOSTNAME": "me", "ROS_IP": "10.0.0.2"}, {"ROS_IP": "10.0.0.3", "ROS_HOSTNAME": None}),
    ({"hostname": "you"}, {"ROS_IP": "10.0.0.2"}, {"ROS_HOSTNAME": "you", "ROS_IP": None}),
]


@pytest.mark.parametrize(("configured", "environ", "expected"), ADDRESSES)
def test_addresses(tmp_path, packages, configured, environ, expected):
    env = environment_in(tmp_path, on(packages, **configured), **environ)
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


def test_the_log_goes_to_the_state_folder(tmp_path, packages):
    config = Config(state=tmp_path / "state", ros1=Ros1Section(packages=packages))
    assert environment_in(tmp_path, config)["ROS_LOG_DIR"].startswith(str(tmp_path / "state"))


def test_the_reason_why_ros1_is_not_available(tmp_path, packages, monkeypatch):
    assert available(on(packages), {}) == ""
    assert "ros1.packages" in available(on(tmp_path), {})
    (packages / "std_msgs" / "msg" / "__init__.py").unlink()
    (packages / "std_msgs" / "msg").rmdir()
    (packages / "std_msgs").rmdir()
    assert "std_msgs" in available(on(packages), {})
    monkeypatch.setattr("bridge.adapters.ros1.environment.PLACES", ())
    assert "apt install" in available(Config(), {})
    with pytest.raises(RuntimeError, match="apt install"):
        worker_environment(Config(), {})


def test_a_sourced_ros1_has_precedence(packages):
    assert packages_folder(Config(), {"PYTHONPATH": f"/nowhere{os.pathsep}{packages}"}) == packages
    assert packages_folder(Config(), {"PYTHONPATH": "/nowhere"}) in (None, *PLACES)


@needs_ros1
def test_real_rospy_with_midspans_libraries(tmp_path):
    code = "import rospy, std_msgs.msg, netifaces, numpy, zenoh; print(std_msgs.msg.String._md5sum, numpy.__file__)"
    env = environment_in(tmp_path, PATH=os.environ["PATH"])
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    md5, numpy = done.stdout.split()
    assert md5 == "992ce8a1687cec8c8bd883ec73ca41d1"
    assert numpy.startswith(sys.prefix)


def test_a_cache_that_cannot_be_written_is_named_with_the_cure(tmp_path, packages):
    (tmp_path / "file").write_text("")
    with pytest.raises(RuntimeError, match=r"file/midspan cannot be written: Not a directory; set .*XDG_CACHE_HOME"):
        worker_environment(Config(ros1=Ros1Section(packages=packages)), {"XDG_CACHE_HOME": str(tmp_path / "file")})
