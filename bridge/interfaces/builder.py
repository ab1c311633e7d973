"""Builds ROS 2 message packages from their definitions, without cmake, ament or colcon.

The builder needs ROS 2's generators (part of the wheels and of /opt/ros/jazzy), gcc and g++. First it plans the
packages, their order and their keys, from the definitions and the installed packages.

A package that a process has imported cannot be loaded again with more types, because Python's module and the shared
libraries stay loaded. Build first, then import; otherwise the process has to be restarted (`activate` returns such
packages).
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bridge.interfaces.cache import SITE, BuildCache, default_cache, digest
from bridge.interfaces.compiler import TIMEOUT, Compiler, Dependency, Job, compile_package
from bridge.interfaces.definition import (
    BuildError,
    Form,
    InterfaceFile,
    Reference,
    read_package,
)
from bridge.interfaces.folders import bundled_files, bundled_packages
from bridge.interfaces.generate import Request
from bridge.interfaces.ros2 import GENERATORS, Ros2

RECIPE = "1"  # increment it when the builder's output for the same definitions changes


@dataclass(frozen=True, slots=True)
class BuildStep:
    """One package to build, with the steps of all packages that it depends on, directly or indirectly."""

    package: str
    definitions: tuple[InterfaceFile, ...]
    needs: tuple[BuildStep, ...]
    prefix: Path


class PackageResolver:
    """Finds the definitions of packages: installed, else ``given`` by the caller or bundled with Midspan."""

    def __init__(self, given: Mapping[str, Mapping[str, str]], ros2: Ros2, cache: BuildCache) -> None:
        self._given = given
        self._ros2 = ros2
        self._cache = cache
        self._steps: dict[str, BuildStep | None] = {}
        self._definitions: dict[str, tuple[InterfaceFile, ...]] = {}

    def steps(self) -> list[BuildStep]:
        """Return the steps for all given packages and their dependencies, in build order."""
        for package in self._given:
            self._step(package, ())
        return [step for step in self._steps.values() if step is not None]

    def _step(self, package: str, requested_by: tuple[str, ...]) -> BuildStep | None:
        """Return the step that builds a package; None if the package is installed."""
        if package in requested_by:
            circle = " -> ".join((*requested_by[requested_by.index(package) :], package))
            raise BuildError(
                f"packages depend on each other: {circle}", cure="Move the shared types to a third package"
            )
        if package not in self._steps:
            self._steps[package] = None if self._is_installed(package) else self._new_step(package, requested_by)
        return self._steps[package]

    def _is_installed(self, package: str) -> bool:
        installed = self._ros2.packages.get(package)
        if installed is None:
            return False
        missing = [path for path in self._given.get(package, {}) if not installed.has(path)]
        if missing:
            raise BuildError(
                f"package {package} {installed.version} of {installed.prefix} has no {missing[0]},"
                " and an installed package cannot be extended",
                cure="Put the definition into a package of another name, and map the type to it",
            )
        return True

    def _new_step(self, package: str, requested_by: tuple[str, ...]) -> BuildStep:
        definitions = self._read(package)
        needed: dict[str, BuildStep] = {}
        installed: list[str] = []
        for name in sorted(frozenset().union(*(definition.needs for definition in definitions))):
            if not self._exists(name):
                raise _unknown_package(name, definitions)
            step = self._step(name, (*requested_by, package))
            if step is None:
                installed.append(f"{name} {self._ros2.packages[name].version}")
            else:
                needed |= {inner.package: inner for inner in (*step.needs, step)}
        self._check_references(definitions)
        texts = [text for definition in definitions for text in (definition.path, definition.text)]
        key = digest(
            [RECIPE, self._ros2.identity, package, *texts, *installed, *(s.prefix.name for s in needed.values())]
        )
        return BuildStep(package, definitions, tuple(needed.values()), self._cache.package(package, key))

    def _exists(self, package: str) -> bool:
        return package in self._given or package in self._ros2.packages or bool(bundled_files(package))

    def _read(self, package: str) -> tuple[InterfaceFile, ...]:
        if package not in self._definitions:
            # a given package adds to the bundled package of the same name, so that both stay usable
            self._definitions[package] = read_package(
                package, bundled_files(package) | dict(self._given.get(package, {}))
            )
        return self._definitions[package]

    def _check_references(self, definitions: tuple[InterfaceFile, ...]) -> None:
        for definition in definitions:
            for reference in definition.references:
                if not self._has(reference):
                    raise _unknown_type(definition, reference)

    def _has(self, reference: Reference) -> bool:
        path = f"{Form.MSG.value}/{reference.name}.{Form.MSG.value}"
        installed = self._ros2.packages.get(reference.package)
        if installed is not None:
            return installed.has(path)
        return any(definition.path == path for definition in self._read(reference.package))


def _unknown_package(name: str, definitions: tuple[InterfaceFile, ...]) -> BuildError:
    for definition in definitions:
        for reference in definition.references:
            if reference.package == name:
                return BuildError(
                    f"package {name} is not known",
                    where=definition.where(reference.line),
                    cure=f"Install it, or put {name}/msg/*.msg into a folder listed in `types.folders`",
                )
    return BuildError(f"ROS 2's package {name} is not installed", cure="Run `make` again")


def _unknown_type(definition: InterfaceFile, reference: Reference) -> BuildError:
    cure = "ROS 2 calls it std_msgs/Header" if reference.name == "Header" else "Check the spelling of the name"
    return BuildError(
        f"unknown type {reference.package}/{reference.name}", where=definition.where(reference.line), cure=cure
    )


JOBS = 2
Progress = Callable[[str], None]


def build(
    packages: Mapping[str, Mapping[str, str]], cache: Path | None = None, progress: Progress | None = None
) -> Path:
    """Build message packages; return a prefix with those that are not installed, and their dependencies.

    Packages of the installed ROS 2, and packages in the cache (default $MIDSPAN_CACHE or ~/.cache/midspan/interfaces),
    are not built again. Dependencies are resolved among the given packages, the installed ones, and Midspan's own
    (`bundled_packages`). Definitions are texts by package and path: ``{"my_msgs": {"msg/Name.msg": "string data"}}``;
    ``progress`` receives a line for each slow step. Raises `BuildError`, which names the place and the cure.
    """
    ros2 = Ros2.find()
    built = BuildCache(cache or default_cache())
    steps = PackageResolver(packages, ros2, built).steps()
    for step in steps:
        if not step.prefix.is_dir():
            _build_step(step, ros2, built, progress or (lambda _: None))
    return built.join(step.prefix for step in steps)


def build_bundled(cache: Path | None = None, progress: Progress | None = None) -> Path:
    """Build the bundled packages that the installed ROS 2 lacks; return the prefix."""
    installed = Ros2.find().packages
    wanted = {name: bundled_files(name) for name in bundled_packages() if name not in installed}
    return build(wanted, cache, progress)


def _build_step(step: BuildStep, ros2: Ros2, cache: BuildCache, progress: Progress) -> None:
    compiler = Compiler.find()
    with cache.adding(step.prefix) as prefix:
        if prefix is None:
            return
        began = time.monotonic()
        count = len(step.definitions)
        progress(f"{step.package}: building {count} definition{'' if count == 1 else 's'}")
        with tempfile.TemporaryDirectory(prefix="midspan-interfaces-") as scratch:
            job = _prepare(step, Path(scratch), prefix, ros2)
            _generate(step, job, prefix, ros2)
            compile_package(job, ros2, compiler)
            _install(step, job, prefix)
        progress(f"{step.package}: built in {time.monotonic() - began:.0f} s")


def _prepare(step: BuildStep, scratch: Path, prefix: Path, ros2: Ros2) -> Job:
    job = Job(
        package=step.package,
        roots={generator: scratch / generator for generator in GENERATORS},
        work=scratch / "work",
        libraries=prefix / "lib",
        extension=prefix / SITE / step.package,
        dependencies=(
            *map(_dependency, step.needs),
            *(Dependency(p.name, p.prefix / "lib") for p in ros2.packages.values()),
        ),
        jobs=min(JOBS, os.cpu_count() or 1),
    )
    for folder in (*job.roots.values(), job.work, job.extension, _share(prefix, step.package)):
        folder.mkdir(parents=True)
    return job


def _dependency(step: BuildStep) -> Dependency:
    # from <cache>/packages/<one>/lib to <cache>/packages/<other>/lib
    runpath = f"$ORIGIN/../../{step.prefix.name}/lib"
    return Dependency(step.package, step.prefix / "lib", runpath, (step.prefix / "include" / step.package,))


def _share(prefix: Path, package: str) -> Path:
    return prefix / "share" / package


def _generate(step: BuildStep, job: Job, prefix: Path, ros2: Ros2) -> None:
    """Run the generators in a separate process."""
    source = job.work / "source"
    for definition in step.definitions:
        _write(source / definition.path, definition.bare)
    known = {name: str(installed.share) for name, installed in ros2.packages.items()}
    known |= {needed.package: str(_share(needed.prefix, needed.package)) for needed in step.needs}
    request: Request = {
        "package": step.package,
        "files": [definition.path for definition in step.definitions],
        "source": str(source),
        "share": str(_share(prefix, step.package)),
        "roots": {generator: str(root) for generator, root in job.roots.items()},
        "resources": {generator: str(ros2.resource(generator)) for generator in GENERATORS},
        "known": known,
        "jobs": job.jobs,
    }
    file = job.work / "request.json"
    file.write_text(json.dumps(request), encoding="utf-8")
    # the order of the #include lines depends on Python's hash seed, which is fixed so that output is reproducible
    environment = os.environ | {"PYTHONHASHSEED": "0"}
    command = [sys.executable, "-P", str(Path(__file__).with_name("generate.py")), str(file)]
    try:
        done = subprocess.run(
            command,
            cwd=job.work,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            check=False,
            stdin=subprocess.DEVNULL,
            env=environment,
            timeout=TIMEOUT,
        )
    except subprocess.TimeoutExpired:
        raise BuildError(f"package {step.package}: ROS 2's generators took more than {TIMEOUT} s") from None
    if done.returncode != 0:
        last = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        raise BuildError(f"package {step.package}: ROS 2's generators failed: {last[0]}")


def _install(step: BuildStep, job: Job, prefix: Path) -> None:
    """Install the files that are neither compiled nor linked."""
    headers = prefix / "include" / step.package
    for root in job.roots.values():
        for file in sorted(root.rglob("*.h")):
            _copy(file, headers / file.relative_to(root))
        for file in sorted(root.rglob("*.py")):
            _copy(file, prefix / SITE / file.relative_to(root))
    (job.extension / "__init__.py").touch()
    share = _share(prefix, step.package)
    for definition in step.definitions:
        _write(share / definition.path, definition.text)
    _write(share / "package.xml", _PACKAGE_XML.format(package=step.package))
    index = prefix / "share" / "ament_index" / "resource_index"
    _write(index / "packages" / step.package, "")
    _write(index / "rosidl_interfaces" / step.package, "".join(f"{d.path}\n" for d in step.definitions))


_PACKAGE_XML = """<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.0.0</version>
  <description>Built by Midspan</description>
  <maintainer email="midspan@localhost">Midspan</maintainer>
  <license>see the definitions' source</license>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
"""


def _write(file: Path, text: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
