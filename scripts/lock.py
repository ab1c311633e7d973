"""Write the lock files: the exact versions that `make` installs.

Run this script on Linux, in the virtual environment, with Python 3.11.

requirements.lock lists the packages that Midspan and its tests need, requirements-ros2.lock the additional ROS 2 wheels
(not installed if a ROS 2 installation is sourced), requirements-kilted.lock the wheels of ROS 2 Kilted for tests. Newer
Pythons use the versions of the oldest supported Python, which the continuous integration verifies. A package that newer
Pythons do not need, such as a backport, has a marker. The files contain versions only; pip uses its configured index.

The files serve every system in SYSTEMS; a line for only some systems has a marker. A package that has no wheel for a
system needs a marker in pyproject.toml, which leaves it out on that system; `midspan doctor` reports it there.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
HEAD = "# Written by scripts/lock.py (`make lock`). Do not edit.\n"
PYTHON = "3.11"
NEWER_PYTHONS = ("3.12", "3.13", "3.14")


@dataclass(frozen=True, eq=False)
class System:
    """A system that the lock files serve.

    Attributes:
        tag: pip's name of the platform; "" for the current system.
        environment: values for markers (https://packaging.python.org/en/latest/specifications/dependency-specifiers/).
        marker: a marker that only this system matches.
    """

    tag: str
    environment: Mapping[str, str]
    marker: str

    def matches(self, requirement: Requirement, extras: Iterable[str] = ()) -> bool:
        """Return whether the requirement's marker matches this system, with one of the requested extras."""
        marker = requirement.marker
        return marker is None or any(marker.evaluate({**self.environment, "extra": e}) for e in ("", *extras))

    def on(self, python: str) -> System:
        """Return this system with another version of Python."""
        versions = {"python_version": python, "python_full_version": f"{python}.0"}
        return replace(self, environment={**self.environment, **versions})


def _environment(sys_platform: str, platform_system: str, os_name: str, machine: str) -> dict[str, str]:
    return {
        "sys_platform": sys_platform,
        "platform_system": platform_system,
        "os_name": os_name,
        "platform_machine": machine,
        "python_version": PYTHON,
        "python_full_version": f"{PYTHON}.0",
        "implementation_name": "cpython",
        "platform_python_implementation": "CPython",
    }


_DARWIN = 'sys_platform == "darwin" and platform_machine'
SYSTEMS = (
    System("", _environment("linux", "Linux", "posix", "x86_64"), 'sys_platform == "linux"'),
    System("win_amd64", _environment("win32", "Windows", "nt", "AMD64"), 'sys_platform == "win32"'),
    System("macosx_14_0_arm64", _environment("darwin", "Darwin", "posix", "arm64"), f'{_DARWIN} == "arm64"'),
    System("macosx_14_0_x86_64", _environment("darwin", "Darwin", "posix", "x86_64"), f'{_DARWIN} == "x86_64"'),
)
Versions = dict[str, str]
"""Versions by package name; ``1.8.0 ; python_version < "3.14"`` if newer Pythons do not need the package."""


def ask_pip(requirements: Iterable[str], system: System, wheels: Path) -> dict[str, dict[str, Any]]:
    """Let pip choose versions for all requirements and dependencies; return their metadata by canonical name."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
    if system.tag:
        command += ["--platform", system.tag, "--python-version", PYTHON, "--only-binary", ":all:"]
        command += ["--target", str(wheels / "nothing"), "--find-links", str(wheels)]
    with tempfile.NamedTemporaryFile(suffix=".json") as report:
        done = subprocess.run([*command, "--report", report.name, *requirements], check=False)
        if done.returncode:
            sys.exit(f"no wheels for {system.tag or 'this system'}: add markers to pyproject.toml for packages without")
        chosen: dict[str, Any] = json.load(report)
    if not system.tag:
        build_sources(chosen["install"], wheels)
    return {canonicalize_name(entry["metadata"]["name"]): entry["metadata"] for entry in chosen["install"]}


def build_sources(chosen: Iterable[Mapping[str, Any]], wheels: Path) -> None:
    """Build wheels of packages published only as source, because pip needs wheels to resolve for other systems."""
    named = [
        f"{e['metadata']['name']}=={e['metadata']['version']}"
        for e in chosen
        if ".whl" not in e["download_info"]["url"]
    ]
    if named:
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(wheels)]
        subprocess.run([*command, *named], check=True)


def reached(
    requirements: Iterable[str], metadata: Mapping[str, Mapping[str, Any]], system: System
) -> tuple[Versions, list[str]]:
    """Return all dependencies on a system, and those that pip skipped because it evaluates its own system's markers."""
    versions: Versions = {}
    missing: list[str] = []
    todo = [(Requirement(text), frozenset[str]()) for text in requirements]
    seen = set()
    while todo:
        requirement, extras = todo.pop()
        name = canonicalize_name(requirement.name)
        wanted = (name, frozenset(requirement.extras))
        if wanted in seen or not system.matches(requirement, extras):
            continue
        if name not in metadata:
            missing.append(f"{requirement.name}{requirement.specifier}")
            continue
        seen.add(wanted)
        versions[metadata[name]["name"]] = metadata[name]["version"]
        needed = metadata[name].get("requires_dist", ())
        todo += [(Requirement(text), frozenset(requirement.extras)) for text in needed]
    return versions, missing


def resolve(requirements: list[str], system: System, wheels: Path) -> Versions:
    """Return the versions of all requirements and dependencies on one system."""
    wanted = [text for text in requirements if system.matches(Requirement(text))]
    more: list[str] = []
    while True:
        metadata = ask_pip([_without_marker(text) for text in (*wanted, *more)], system, wheels)
        versions, missing = reached(wanted, metadata, system)
        if not missing:
            return marked(versions, wanted, metadata, system)
        more += missing


def marked(
    versions: Versions, requirements: Iterable[str], metadata: Mapping[str, Mapping[str, Any]], system: System
) -> Versions:
    """Return the versions, with a marker for each package that a newer Python does not need."""
    for python in reversed(NEWER_PYTHONS):
        needed, _ = reached(requirements, metadata, system.on(python))
        plain = {name: version.partition(" ; ")[0] for name, version in versions.items() if name not in needed}
        versions |= {name: f'{version} ; python_version < "{python}"' for name, version in plain.items()}
    return versions


def _without_marker(text: str) -> str:
    return text.partition(";")[0].strip()


def write(file: str, of_systems: Mapping[System, Versions], own: Mapping[str, str]) -> None:
    """Write one lock file, sorted by name.

    ``own``: markers of pyproject.toml by package name, which replace the computed markers, as newer Pythons need them.
    """
    systems_of: dict[tuple[str, str], list[System]] = {}
    for system, versions in of_systems.items():
        for pin in versions.items():
            systems_of.setdefault(pin, []).append(system)
    lines = []
    for (name, text), systems in sorted(systems_of.items(), key=lambda item: (item[0][0].lower(), item[0][1])):
        version, _, python = text.partition(" ; ")
        place = "" if len(systems) == len(SYSTEMS) else " or ".join(system.marker for system in systems)
        if " or " in place and python:
            place = f"({place})"
        marker = own.get(canonicalize_name(name), " and ".join(filter(None, (place, python))))
        lines.append(f"{name}=={version}{marker and f' ; {marker}'}\n")
    (ROOT / file).write_text(HEAD + "".join(lines), encoding="utf-8")


def requirements_without_ros2(settings: Mapping[str, Any]) -> list[str]:
    """Return what requirements.lock pins, from the content of pyproject.toml."""
    extras, dev = settings["project"]["optional-dependencies"], settings["dependency-groups"]["dev"]
    return [*settings["project"]["dependencies"], *extras["sim"], *extras["web"], *extras["foxglove"], *dev]


def main() -> None:
    """Resolve everything together for each system, then separate the part without ROS 2 wheels."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras, dev = settings["project"]["optional-dependencies"], settings["dependency-groups"]["dev"]
    base = requirements_without_ros2(settings)
    plain: dict[System, Versions] = {}
    ros2: dict[System, Versions] = {}
    with tempfile.TemporaryDirectory() as folder:
        for system in SYSTEMS:
            whole = resolve([*base, *extras["ros2"]], system, Path(folder))
            plain[system] = whole
            if any(system.matches(Requirement(text)) for text in extras["ros2"]):
                without_ros2 = resolve(base, system, Path(folder))
                same = [f"{name}=={whole[name]}" for name in without_ros2 if name in whole]
                plain[system] = resolve([*base, *same], system, Path(folder))
            ros2[system] = {name: version for name, version in whole.items() if name not in plain[system]}
        kilted = resolve(settings["dependency-groups"]["kilted"], SYSTEMS[0], Path(folder))
    kept_markers = {
        str(canonicalize_name(r.name)): str(r.marker) for r in map(Requirement, [*extras["sim"], *dev]) if r.marker
    }
    write("requirements.lock", plain, kept_markers)
    write("requirements-ros2.lock", ros2, kept_markers)
    # other packages that Kilted's packages import are in the virtual environment
    others = {name: version for name, version in kilted.items() if name.startswith("ros-")}
    write("requirements-kilted.lock", {SYSTEMS[0]: others}, {})


if __name__ == "__main__":
    main()
