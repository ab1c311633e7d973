"""The lock files name exact versions, of everything that is needed, and what is installed here is what they say."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import re
import subprocess
import tomllib

from tests.setup.machine import ROOT

PIN = re.compile(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+")


def plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def pins(*files: str) -> dict[str, str]:
    lines = [line for file in files for line in (ROOT / file).read_text(encoding="utf-8").splitlines()]
    lines = [line for line in lines if not line.startswith("#")]
    assert [line for line in lines if not PIN.fullmatch(line)] == []
    return {plain(name): version for name, _, version in (line.partition("==") for line in lines)}


def test_every_requirement_is_locked() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    for files, requirements in (
        (["requirements.lock"], [*project["dependencies"], *extras["dev"]]),
        (["requirements-ros2.lock"], extras["ros2"]),
    ):
        locked = pins(*files)
        for requirement in requirements:
            name, _, version = re.sub(r"\[.*?\]", "", requirement).partition("==")
            name = re.split(r"[<>=]", name)[0]
            assert plain(name) in locked, requirement
            assert not version or locked[plain(name)] == version, requirement


def test_the_locked_versions_are_installed() -> None:
    files = ["requirements.lock"]
    if importlib.util.find_spec("ros_wheels_bootstrapper"):
        files.append("requirements-ros2.lock")
    locked = pins(*files)
    assert {name: importlib.metadata.version(name) for name in locked} == locked


def test_make_lists_its_targets() -> None:
    told = subprocess.run(["make", "-C", ROOT], capture_output=True, text=True, check=True, timeout=60).stdout
    for target in ("demo", "test", "lint", "types", "check", "bench", "clean"):
        assert re.search(rf"^{target}\s+\S", told, re.MULTILINE), target
