"""Compiles and links the generators' output, using only gcc and g++.

All files of one generator and one folder become one translation unit, because they include the same headers, which take
most of the time. On 2 cores nav2_msgs (51 definitions, 358 generated files) takes 11 s, compared to 23 s for separate
files. Only the type descriptions are compiled separately, because their static names collide.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from bridge.interfaces.definition import BuildError
from bridge.interfaces.ros2 import GENERATORS, Ros2

_CURE_COMPILER = "Install one: apt install g++"
_FLAGS = ("-O0", "-fPIC", "-w")
"""Optimizing generated code gains little: rclpy takes 4 % less time for 2,000 nested parts, and no less for arrays of
bytes. But it costs much: with -O1 the bundled packages take 84 s of processor time instead of 53 s."""
_STANDARD = {".c": "-std=gnu11", ".cpp": "-std=gnu++17"}
TIMEOUT = 900  # seconds for one call of a compiler or of the generators; the longest measured call took 10 s
_RUNTIME = (
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp",
    "rosidl_typesupport_introspection_c",
    "rosidl_typesupport_c",
    "rosidl_runtime_c",
    "rcutils",
    "rmw",
    "fastcdr",
)


@dataclass(frozen=True, slots=True)
class Dependency:
    """A message package to compile and link against.

    ``runpath`` is the path to its libraries at run time (``$ORIGIN/...``), "" if the process finds them anyway;
    ``includes`` are the folders of its headers, unless these belong to the installation.
    """

    name: str
    libraries: Path
    runpath: str = ""
    includes: tuple[Path, ...] = ()


@dataclass(frozen=True, slots=True)
class Compiler:
    """The C and C++ compilers."""

    c: str
    cpp: str

    @classmethod
    def find(cls) -> Compiler:
        """Find the compilers of this machine; raises `BuildError` if one of them or Python's headers are missing."""
        paths: list[str] = []
        for variable, usual in (("CC", "gcc"), ("CXX", "g++")):
            name = os.environ.get(variable) or usual
            path = shutil.which(name)
            if path is None:
                raise BuildError(f"no compiler: '{name}' is not on the PATH", cure=_CURE_COMPILER)
            paths.append(path)
        headers = Path(sysconfig.get_path("include"))
        if not (headers / "Python.h").is_file():
            raise BuildError(
                f"no Python headers: {headers}/Python.h not found", cure="Install them: apt install python3-dev"
            )
        return cls(paths[0], paths[1])


@dataclass(frozen=True, slots=True)
class Job:
    """One package to compile; ``roots`` are the output folders by generator, ``jobs`` limits the parallel compilers."""

    package: str
    roots: dict[str, Path]
    work: Path
    libraries: Path
    extension: Path
    dependencies: tuple[Dependency, ...]
    jobs: int


def compile_package(job: Job, ros2: Ros2, compiler: Compiler) -> None:
    """Build a package's shared libraries and Python extension; raises `BuildError` with the first error line."""
    includes = [f"-I{folder}" for folder in _includes(job, ros2)]
    units = [unit for generator in GENERATORS for unit in _units(job, generator)]
    units.sort(key=lambda unit: -sum(file.stat().st_size for file in unit.files))  # longest first, to finish together

    def compile_unit(unit: _Unit) -> None:
        command = compiler.c if unit.language == ".c" else compiler.cpp
        define = f'-DROS_PACKAGE_NAME="{job.package}"'
        _run([command, _STANDARD[unit.language], *_FLAGS, define, *includes, "-c", *unit.sources()], unit.folder)

    with ThreadPoolExecutor(job.jobs) as pool:
        list(pool.map(compile_unit, units))
    _Linker(job, ros2, compiler.cpp).link_all()


def _includes(job: Job, ros2: Ros2) -> Iterable[Path]:
    yield from job.roots.values()
    for dependency in job.dependencies:
        yield from dependency.includes
    yield from ros2.includes
    yield Path(sysconfig.get_path("include"))
    yield _numpy_headers()


@cache
def _numpy_headers() -> Path:
    import numpy as np

    return Path(np.get_include())


@dataclass(frozen=True, slots=True)
class _Unit:
    """The files of one compiler call: included by one common file, or, if ``separately``, compiled one by one."""

    folder: Path
    language: str
    files: tuple[Path, ...]
    separately: bool = False

    def sources(self) -> list[str]:
        if self.separately:
            return [str(file) for file in self.files]
        whole = self.folder / f"whole{self.language}"
        whole.write_text("".join(f'#include "{file}"\n' for file in self.files), encoding="utf-8")
        return [str(whole)]


def _units(job: Job, generator: str) -> Iterable[_Unit]:
    root = job.roots[generator] / job.package
    for language in _STANDARD:
        for form in ("msg", "srv", "action"):
            files = sorted((root / form).rglob(f"*{language}"))
            descriptions = [file for file in files if file.stem.endswith("__description")]
            together = [file for file in files if file not in descriptions]
            name = f"{generator}-{form}{language}"
            if together:
                yield _Unit(_fresh(job.work / name), language, tuple(together))
            for number, part in enumerate(_cut(descriptions, job.jobs)):
                yield _Unit(_fresh(job.work / f"{name}-descriptions{number}"), language, part, separately=True)
        entries = sorted(root.glob(f"*{language}"))
        if entries:
            yield _Unit(_fresh(job.work / f"{generator}-entry"), language, tuple(entries))


def _cut(files: Sequence[Path], parts: int) -> list[tuple[Path, ...]]:
    return [part for part in (tuple(files[start::parts]) for start in range(parts)) if part]


def _fresh(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


class _Linker:
    """Links a package's five libraries and its extension, with the names that ROS 2 uses.

    At run time `librosidl_typesupport_c` opens the two type supports by their bare names. The dynamic loader finds them
    by their SONAME because the extension, which is loaded first, links to them, so no library path is needed.
    """

    def __init__(self, job: Job, ros2: Ros2, command: str) -> None:
        self._job = job
        self._command = command
        self._paths = [
            f"-L{folder}" for folder in (job.libraries, *(d.libraries for d in job.dependencies), *ros2.libraries)
        ]
        self._others = [f"-l{library}" for d in job.dependencies for library in _libraries_of(d)]
        self._others += [f"-l{library}" for library in _RUNTIME]
        self._runpaths = [f"-Wl,-rpath,{d.runpath}" for d in job.dependencies if d.runpath]

    def link_all(self) -> None:
        """Link everything, the libraries in the order in which they need each other."""
        package = self._job.package
        linked: list[str] = []
        generators = ("rosidl_generator_c", "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
        for generator in (*generators, "rosidl_typesupport_c", "rosidl_generator_py"):
            self._link(
                self._job.libraries / f"lib{package}__{generator}.so", [f"{generator}-[msa]*"], linked, "$ORIGIN"
            )
            linked.append(f"{package}__{generator}")
        extension = self._job.extension / f"{package}_s__rosidl_typesupport_c.so"
        up = Path(os.path.relpath(self._job.libraries, self._job.extension))
        self._link(extension, ["rosidl_generator_py-entry"], linked, f"$ORIGIN/{up}")

    def _link(self, output: Path, objects: list[str], own: list[str], origin: str) -> None:
        files = [str(file) for pattern in objects for file in sorted(self._job.work.glob(f"{pattern}/*.o"))]
        _run(
            [
                self._command, "-shared", "-s", "-o", str(output), *files, f"-Wl,-soname,{output.name}",
                "-Wl,--enable-new-dtags", f"-Wl,-rpath,{origin}", *self._runpaths, *self._paths,
                # link the type supports even if the extension does not call them
                "-Wl,--no-as-needed", *(f"-l{library}" for library in own),
                "-Wl,--as-needed", *self._others, "-Wl,--allow-shlib-undefined",
            ],
            self._job.work,
        )  # fmt: skip


def _libraries_of(dependency: Dependency) -> list[str]:
    names = (f"{dependency.name}__{generator}" for generator in GENERATORS)
    return [name for name in names if (dependency.libraries / f"lib{name}.so").is_file()]


def _run(command: list[str], folder: Path) -> None:
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, encoding="utf-8", errors="replace", check=False,
            stdin=subprocess.DEVNULL, timeout=TIMEOUT,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise BuildError(f"{Path(command[0]).name} took more than {TIMEOUT} s in {folder.name}") from None
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        first = next((line for line in lines if "error" in line), lines[-1] if lines else "no message")
        raise BuildError(f"{Path(command[0]).name} failed in {folder.name}: {first.strip()}")
