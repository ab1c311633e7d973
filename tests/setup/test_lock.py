"""The lock files pin all requirements on each system; the installed versions match them."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import re
import subprocess
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from scripts import lock
from tests.setup.machine import ROOT

PIN = re.compile(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+( ; [a-z0-9_=<. \"()]+)?")
FILES = ("requirements.lock", "requirements-ros2.lock")
SYSTEMS: dict[str, dict[str, str]] = {
    "Linux": {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix", "platform_machine": "x86_64"},
    "Windows": {"sys_platform": "win32", "platform_system": "Windows", "os_name": "nt", "platform_machine": "AMD64"},
    "macOS": {"sys_platform": "darwin", "platform_system": "Darwin", "os_name": "posix", "platform_machine": "arm64"},
    "Intel Mac": {
        "sys_platform": "darwin",
        "platform_system": "Darwin",
        "os_name": "posix",
        "platform_machine": "x86_64",
    },
}
every_system = pytest.mark.parametrize("system", SYSTEMS)


def pins(*files: str, system: str = "Linux", python: str = "3.11") -> dict[str, str]:
    """Return the version of each package that the files pin for a system and a version of Python."""
    lines = [line for file in files for line in (ROOT / file).read_text(encoding="utf-8").splitlines()]
    lines = [line for line in lines if not line.startswith("#")]
    assert [line for line in lines if not PIN.fullmatch(line)] == []
    locked: dict[str, str] = {}
    for requirement in map(Requirement, lines):
        if requirement.marker is None or requirement.marker.evaluate({**SYSTEMS[system], "python_version": python}):
            name = canonicalize_name(requirement.name)
            assert name not in locked, f"{name} has two versions for {system}"
            locked[name] = str(requirement.specifier).removeprefix("==")
    return locked


def lacking(requirements: Iterable[str], locked: Mapping[str, str], system: str) -> list[str]:
    """Return the requirements that the locked versions do not meet on a system."""
    environment = {**SYSTEMS[system], "extra": "", "python_version": "3.11", "python_full_version": "3.11.2"}
    wanted = [r for r in map(Requirement, requirements) if r.marker is None or r.marker.evaluate(environment)]
    return [str(r) for r in wanted if not r.specifier.contains(locked.get(canonicalize_name(r.name), "none"))]


def settings() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def project() -> dict[str, Any]:
    return settings()["project"]


@every_system
def test_every_requirement_is_locked(system: str) -> None:
    extras = project()["optional-dependencies"]
    plain = pins("requirements.lock", system=system)
    dev = settings()["dependency-groups"]["dev"]
    assert lacking([*project()["dependencies"], *extras["sim"], *dev], plain, system) == []
    assert lacking(extras["ros2"], pins("requirements-ros2.lock", system=system), system) == []


def test_kilted_is_locked() -> None:
    """The lock contains only ROS 2 packages, so that it replaces nothing else in the virtual environment."""
    locked = pins("requirements-kilted.lock")
    assert lacking(settings()["dependency-groups"]["kilted"], locked, "Linux") == []
    assert [name for name in locked if not name.startswith("ros-")] == []


@every_system
def test_requirements_of_locked_packages_are_locked(system: str) -> None:
    """This covers the packages that are installed here in the version locked for the system, by their metadata."""
    locked = pins(*FILES, system=system)
    met = [name for name, version in locked.items() if installed(name) == version]
    assert len(met) > 50
    assert [f"{n} needs {r}" for n in met for r in lacking(importlib.metadata.requires(n) or (), locked, system)] == []


@pytest.mark.parametrize("python", lock.NEWER_PYTHONS)
def test_newer_pythons_get_nothing_that_they_do_not_need(python: str) -> None:
    """For example, a backport has no wheel for the Python version that already contains its module."""
    metadata = {
        canonicalize_name(d.name): {"name": d.name, "version": d.version, "requires_dist": d.requires or ()}
        for d in importlib.metadata.distributions()
    }
    needed, _ = lock.reached(lock.requirements_without_ros2(settings()), metadata, lock.SYSTEMS[0].on(python))
    names = {canonicalize_name(name) for name in needed}
    assert sorted(pins("requirements.lock", python=python).keys() - names) == []


def test_a_package_that_newer_pythons_do_not_need_gets_a_marker() -> None:
    metadata = {
        "bags": {"name": "bags", "version": "2", "requires_dist": ["zstd ; python_version < '3.13'", "plain"]},
        "zstd": {"name": "zstd", "version": "1.8"},
        "plain": {"name": "plain", "version": "3"},
    }
    linux = lock.SYSTEMS[0]
    versions, missing = lock.reached(["bags"], metadata, linux)
    assert missing == []
    marker = '1.8 ; python_version < "3.13"'
    assert lock.marked(versions, ["bags"], metadata, linux) == {"bags": "2", "zstd": marker, "plain": "3"}


def test_development_dependencies_are_groups_and_no_extras() -> None:
    """With dependency groups (PEP 735), users see only extras that they can use in the metadata. No extra is empty."""
    assert sorted(settings()["dependency-groups"]) == ["bench", "dev", "dist", "kilted"]
    extras = project()["optional-dependencies"]
    assert not set(extras) & {"bench", "dev", "dist", "kilted"}
    assert [name for name, requirements in extras.items() if not requirements] == []


def test_the_docs_table_names_all_extras() -> None:
    page = (ROOT / "docs/start/pip.md").read_text(encoding="utf-8")
    table = page.partition("\n## Extras\n")[2].partition("\n## ")[0]
    named = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    assert {"ros2", "sim", "web"} <= set(named)
    assert sorted(named) == sorted(project()["optional-dependencies"])


def installed(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""


def test_ros2_wheels_are_only_for_linux() -> None:
    assert pins("requirements-ros2.lock")
    assert [pins("requirements-ros2.lock", system=s) for s in SYSTEMS if s != "Linux"] == [{}, {}, {}]


def test_the_locked_versions_are_installed() -> None:
    files = FILES if importlib.util.find_spec("ros_wheels_bootstrapper") else FILES[:1]
    locked = pins(*files)
    assert {name: importlib.metadata.version(name) for name in locked} == locked


def test_make_lists_its_targets() -> None:
    output = subprocess.run(["make", "-C", ROOT], capture_output=True, text=True, check=True, timeout=100).stdout
    for target in ("demo", "test", "lint", "types", "check", "bench", "clean"):
        assert re.search(rf"^{target}\s+\S", output, re.MULTILINE), target
