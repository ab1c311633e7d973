"""Builds ROS 2 message packages from their definitions, without cmake, ament or colcon.

What it takes: ROS 2's generators (they come with the wheels and with /opt/ros/jazzy), gcc and g++.

A package that a process has imported cannot be loaded again with more types: Python's module and the shared libraries
stay as they are. Build first, then import; a process that is too late has to be started anew (`activate` tells).
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
from pathlib import Path

from bridge.interfaces.compiler import TIMEOUT, Compiler, Dependency, Job, compile_package
from bridge.interfaces.errors import BuildError
from bridge.interfaces.generate import Request
from bridge.interfaces.plan import Planner, Step
from bridge.interfaces.ros2 import GENERATORS, Ros2
from bridge.interfaces.standing import standing_files, standing_packages
from bridge.interfaces.store import SITE, Store, default_cache

JOBS = 2
Progress = Callable[[str], None]


def build(
    packages: Mapping[str, Mapping[str, str]], cache: Path | None = None, progress: Progress | None = None
) -> Path:
    """Build message packages and return a prefix with all of them and what they need.

    What an installed ROS 2 already has is not built; what was built before, by any process, is found in the cache.
    Needed packages are looked for among those given, those installed, and Midspan's own (`standing_packages`).

    Args:
        packages: definitions by package and path: ``{"my_msgs": {"msg/Name.msg": "string data"}}``.
        cache: the cache folder; default $MIDSPAN_CACHE or ~/.cache/midspan/interfaces.
        progress: told one line for each thing that takes time; called on this thread.

    Returns:
        A prefix for `bridge.interfaces.paths.activate` or `environment`.

    Raises:
        BuildError: with the place in the definition, or what is missing, and the cure.
    """
    ros2 = Ros2.find()
    store = Store(cache or default_cache())
    steps = Planner(packages, ros2, store).steps()
    for step in steps:
        if not step.prefix.is_dir():
            _build_step(step, ros2, store, progress or _silent)
    return store.join(step.prefix for step in steps)


def build_standing(cache: Path | None = None, progress: Progress | None = None) -> Path:
    """Build Midspan's own packages as far as the installed ROS 2 lacks them; returns the prefix."""
    installed = Ros2.find().packages
    wanted = {name: standing_files(name) for name in standing_packages() if name not in installed}
    return build(wanted, cache, progress)


def _silent(line: str) -> None:
    """Tell nobody."""


def _build_step(step: Step, ros2: Ros2, store: Store, progress: Progress) -> None:
    compiler = Compiler.find()
    with store.adding(step.prefix) as prefix:
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


def _prepare(step: Step, scratch: Path, prefix: Path, ros2: Ros2) -> Job:
    job = Job(
        package=step.package,
        roots={generator: scratch / generator for generator in GENERATORS},
        work=scratch / "work",
        libraries=prefix / "lib",
        extension=prefix / SITE / step.package,
        dependencies=(
            *map(_built, step.needs),
            *(Dependency(p.name, p.prefix / "lib") for p in ros2.packages.values()),
        ),
        jobs=min(JOBS, os.cpu_count() or 1),
    )
    for folder in (*job.roots.values(), job.work, job.extension, _share(prefix, step.package)):
        folder.mkdir(parents=True)
    return job


def _built(step: Step) -> Dependency:
    # from <cache>/packages/<one>/lib to <cache>/packages/<other>/lib
    runpath = f"$ORIGIN/../../{step.prefix.name}/lib"
    return Dependency(step.package, step.prefix / "lib", runpath, (step.prefix / "include" / step.package,))


def _share(prefix: Path, package: str) -> Path:
    return prefix / "share" / package


def _generate(step: Step, job: Job, prefix: Path, ros2: Ros2) -> None:
    """Run the generators, in a process of their own."""
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
    # the order of the #include lines hangs on Python's hash seed; fixed, so that equal input gives equal output
    environment = os.environ | {"PYTHONHASHSEED": "0"}
    command = [sys.executable, "-P", str(Path(__file__).with_name("generate.py")), str(file)]
    try:
        done = subprocess.run(
            command,
            cwd=job.work,
            capture_output=True,
            text=True,
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


def _install(step: Step, job: Job, prefix: Path) -> None:
    """Put what is neither compiled nor linked into its place."""
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
