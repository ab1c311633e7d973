"""`scripts/setup.sh` on simulated machines: its installations, and its behavior if something is unavailable."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.setup.machine import Machine

AGAIN = ["python -m compileall -q -j 2 bridge navigation sim yarp_compat", "midspan interfaces build"]
"""Commands that each run executes, and that do nothing if everything is up to date."""


def test_a_new_machine_is_set_up_once(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    assert machine.setup().returncode == 0
    assert not machine.called("apt-get"), "all packages are installed"
    assert [call.split()[1:3] for call in machine.called("venv")] == [["-m", "venv"]]
    installs = machine.called("pip install")
    assert ["--no-deps" in call for call in installs] == [True, True, True, True]
    pip, *targets = [call.split()[-1] for call in installs]
    assert pip.startswith("pip=="), "the rest is installed with the locked pip"
    assert targets == ["requirements.lock", "requirements-ros2.lock", "."]
    assert machine.calls[-1] == "midspan interfaces build"
    assert machine.setup().returncode == 0
    assert machine.calls == AGAIN


def test_kernels_are_compiled_once_and_a_failure_is_reported(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    assert machine.setup().returncode == 0
    assert len(machine.called("build_ext", "--inplace")) == 1
    machine.setup()
    assert not machine.called("build_ext")
    without = Machine(tmp_path / "without")
    done = without.setup(NO_COMPILER="1")
    assert done.returncode == 0, "the set-up continues"
    assert "2 of 3 kernels are not compiled" in done.stderr
    assert "apt install g++" in done.stderr
    assert without.setup(NO_COMPILER="1", CI="true").returncode == 1


def test_only_a_run_that_changes_something_replaces_the_log(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    machine.setup()
    log = machine.checkout / ".cache" / "setup.log"
    log.write_text("of an earlier run\n", encoding="utf-8")
    machine.setup()
    assert "earlier" in log.read_text(encoding="utf-8"), "nothing had to be done"
    (machine.checkout / "requirements.lock").write_text("more==1.0\n", encoding="utf-8")
    machine.setup()
    assert "earlier" not in log.read_text(encoding="utf-8")


def test_a_new_lock_file_is_installed(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    machine.setup()
    with (machine.checkout / "requirements.lock").open("a", encoding="utf-8") as lock:
        lock.write("more==1.0\n")
    machine.setup()
    assert machine.called("requirements.lock")
    assert not machine.called("venv"), "the virtual environment is kept"


def test_a_moved_checkout_is_set_up_again(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    machine.setup()
    machine.checkout = machine.checkout.rename(tmp_path / "moved here")
    assert machine.setup().returncode == 0
    assert machine.called("venv", "--clear")


def test_a_sourced_ros2_is_used_instead_of_the_wheels(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    machine.setup()
    sourced = {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": "/opt/ros/jazzy"}
    assert machine.setup(**sourced).returncode == 0
    assert machine.called("venv", "--clear"), "the virtual environment is created again, without the wheels"
    assert not machine.called("requirements-ros2.lock")
    machine.setup(**sourced)
    assert machine.calls == AGAIN


def test_missing_packages_are_installed_as_root(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    machine.setup(NOT_INSTALLED="g++ python3-rospy")
    assert [call.split()[-2:] for call in machine.called("apt-get", "install")] == [["g++", "python3-rospy"]]


def test_missing_packages_are_installed_with_sudo(tmp_path: Path) -> None:
    machine = Machine(tmp_path, user=1000, sudo=True)
    assert machine.setup(NOT_INSTALLED="python3-rospy").returncode == 0
    assert machine.called("sudo -n env", "apt-get", "install", "python3-rospy")


def test_prometheus_and_nginx_are_unpacked_once_and_only_in_ci(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    assert machine.setup().returncode == 0
    assert not machine.called("dpkg-deb")
    assert machine.setup(CI="true").returncode == 0
    for package in ("prometheus", "nginx"):
        assert machine.called("apt-get", "download", package)
        assert machine.called("dpkg-deb", "-x", f"{package}_1_amd64.deb")
    machine.setup(CI="true")
    assert not machine.called("dpkg-deb")


LACKING: list[tuple[str, dict[str, bool | int], dict[str, str], str]] = [
    ("no apt", {"apt": False}, {}, "no apt on this system"),
    ("no root", {"user": 1000}, {"NOT_INSTALLED": "python3-rospy"}, "administrator for: apt-get install python3-rospy"),
    (
        "not in the archive",
        {},
        {"NOT_INSTALLED": "python3-rospy", "NOT_IN_ARCHIVE": "python3-rospy"},
        "no python3-rospy in this system's archive, and none is needed",
    ),
    (
        "only named by other packages",
        {},
        {"NOT_INSTALLED": "g++ python3-tf2", "ONLY_NAMED": "python3-tf2"},
        "archive: python3-tf2",
    ),
    ("no wheels", {}, {"NO_WHEELS": "1"}, "ROS 2 (DDS) is left out"),
]


@pytest.mark.parametrize(("machine", "variables", "word"), [case[1:] for case in LACKING], ids=[c[0] for c in LACKING])
def test_unavailable_parts_are_reported_and_are_an_error_in_ci(
    tmp_path: Path, machine: dict[str, bool], variables: dict[str, str], word: str
) -> None:
    at_home = Machine(tmp_path / "home", **machine)
    done = at_home.setup(**variables)
    assert word in done.stderr
    assert done.returncode == 0
    assert at_home.called("--editable"), "the rest is installed"
    in_ci = Machine(tmp_path / "ci", **machine).setup(**variables, CI="true")
    assert word in in_ci.stderr
    assert in_ci.returncode != 0


def test_apt_is_not_called_again_for_unavailable_packages(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    lacking = {"NOT_INSTALLED": "python3-tf2", "NOT_IN_ARCHIVE": "python3-tf2"}
    machine.setup(**lacking)
    assert machine.called("apt-get", "update")
    done = machine.setup(**lacking)
    assert done.stderr == ""
    assert not machine.called("apt-get")


def test_a_system_without_rospy_is_reported_once_and_gets_no_ros1_packages(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    ubuntu = {"NOT_INSTALLED": "g++ python3-rospy python3-std-msgs", "NOT_IN_ARCHIVE": "python3-rospy"}
    done = machine.setup(**ubuntu)
    assert "Midspan has its own ROS 1 node and master" in done.stderr
    assert "archive:" not in done.stderr
    assert [call.split()[-2:] for call in machine.called("apt-get", "install")] == [["--no-install-recommends", "g++"]]
    again = machine.setup(NOT_INSTALLED="python3-rospy python3-std-msgs", NOT_IN_ARCHIVE="python3-rospy")
    assert "apt" not in again.stderr
    compiler = machine.setup(**ubuntu)
    assert machine.called("apt-get", "install", "g++"), "an installation that failed is tried again"
    assert compiler.returncode == 0


def test_failed_wheels_are_installed_at_the_next_run(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    machine.setup(NO_WHEELS="1")
    machine.setup()
    assert machine.called("requirements-ros2.lock")


def test_kilted_is_installed_once_for_tests_and_shared_by_checkouts(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    cache = {"KILTED": "yes", "XDG_CACHE_HOME": str(tmp_path / "cache")}
    machine.setup()
    assert not machine.called("requirements-kilted.lock")
    assert machine.setup(**cache).returncode == 0
    (install,) = machine.called("requirements-kilted.lock")
    assert "--ignore-installed" in install, "Jazzy's packages are not removed"
    assert (machine.checkout / ".cache/kilted/lib").is_dir()
    machine.setup(**cache)
    assert machine.calls == AGAIN
    other = Machine(tmp_path / "other")
    other.setup(**cache)
    assert not other.called("requirements-kilted.lock")
    assert (other.checkout / ".cache/kilted/lib").is_dir()


def test_kilted_is_omitted_if_it_cannot_be_installed(tmp_path: Path) -> None:
    machine = Machine(tmp_path)
    done = machine.setup(KILTED="yes", NO_WHEELS="1")
    assert done.returncode == 0
    assert "tests with its programs are skipped" in done.stderr
