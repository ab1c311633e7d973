"""Kernels are compiled from this tree's sources; a missing build, or a build of other sources, is reported."""

from __future__ import annotations

import importlib.util
import json
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from setuptools import Distribution, Extension  # type: ignore[import-untyped]

from bridge import kernels
from bridge.doctor.check import Result
from bridge.doctor.checks import machine
from navigation.status import not_compiled
from tests.doctor.parts import around, only
from tests.support.missing import COMPILER, needs


@needs(COMPILER)
def test_kernels_are_compiled_from_the_sources_of_this_tree() -> None:
    assert kernels.state().ok, f"{kernels.state()}: run 'make setup'"


EQUAL = {"acos", "asin", "atan2", "ceil", "cos", "floor", "isfinite", "isinf", "isnan", "rint", "sin", "sqrt"}
"""Functions of the C library whose results are equal on x86-64 with FMA and on arm64; ``hypot`` is not one of them."""


def test_kernels_call_no_function_that_rounds_differently_on_another_processor() -> None:
    imported = {
        (module, name.strip())
        for module in kernels.KERNELS
        for names in re.findall(r"libc\.math import (.+)", kernels.source(module).read_text(encoding="utf-8"))
        for name in names.split(",")
    }
    assert {name for _, name in imported} >= {"cos", "sqrt"}
    assert {(module, name) for module, name in imported if name not in EQUAL} == set()


@needs(COMPILER)
def test_every_kernel_is_imported_compiled() -> None:
    for module in (*kernels.KERNELS, *kernels.C_MODULES):
        spec = importlib.util.find_spec(module)
        assert spec is not None
        assert spec.origin == str(kernels.built(module))
        assert kernels.source(module).is_file(), "a wheel also contains the source, for machines that cannot compile"


def test_a_kernel_that_cannot_be_compiled_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cython makes new `Extension` objects without ``optional``, so that one failure would end the whole build."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "kernels", kernels)
    monkeypatch.setattr(
        "Cython.Build.cythonize", lambda made, **_: [Extension(extension.name, extension.sources) for extension in made]
    )
    script = runpy.run_path(str(kernels.ROOT / "setup.py"))
    build = script["BuildKernels"](Distribution())
    build.extensions = [script["_extension"](kernels.KERNELS[0])]
    build._generate()
    assert [extension.optional for extension in build.extensions] == [True]


@pytest.mark.parametrize(("name", "calls"), [("__main__", 1), ("__mp_main__", 0)])
def test_only_the_script_itself_builds(name: str, calls: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cython's processes import setup.py if they are not forked: on macOS, Windows, and with Python 3.14."""
    monkeypatch.setitem(sys.modules, "kernels", kernels)
    called: list[object] = []
    monkeypatch.setattr("setuptools.setup", lambda **settings: called.append(settings))
    runpy.run_path(str(kernels.ROOT / "setup.py"), run_name=name)
    assert len(called) == calls


def test_equal_sources_are_compiled_once_with_a_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kernels", kernels)
    monkeypatch.setattr("setuptools.command.build_ext.build_ext.run", pretend_to_compile)
    monkeypatch.setenv("MIDSPAN_KERNEL_CACHE", str(tmp_path / "cache"))
    script = runpy.run_path(str(kernels.ROOT / "setup.py"))
    command, recipe = script["BuildKernels"], script["kernels"]
    monkeypatch.setattr(command, "_generate", lambda _: None)
    monkeypatch.setattr(recipe, "ROOT", tmp_path)
    monkeypatch.setattr(recipe, "KERNELS", modules := ("bridge.one", "bridge.two"))
    (tmp_path / "bridge").mkdir()
    for module in modules:
        recipe.source(module).write_text(f"NAME = {module!r}\n", encoding="utf-8")

    def compiled(place: str) -> list[str]:
        extensions = [Extension(name, [str(recipe.source(name))]) for name in modules]
        build = command(Distribution({"ext_modules": extensions}))
        build.build_lib, build.compiled = str(tmp_path / place), []
        build.finalize_options()
        build.run()
        for module in modules:
            built = tmp_path / place / build.get_ext_filename(module)
            assert built.read_bytes() == recipe.source(module).read_bytes()
        record = json.loads((tmp_path / place / "bridge" / kernels.RECORD).read_text(encoding="utf-8"))
        assert record.keys() == {*modules, "cython"}
        return build.compiled

    assert compiled("first") == ["bridge.one", "bridge.two"]
    assert compiled("again") == []
    recipe.source("bridge.two").write_text("Y = 2\n", encoding="utf-8")
    assert compiled("another source") == ["bridge.two"]
    monkeypatch.setattr(recipe, "FLAGS", ("-O0",))
    assert compiled("other flags") == ["bridge.one", "bridge.two"]
    monkeypatch.setenv("CFLAGS", "-g")
    script["_toolchain"].cache_clear()
    assert compiled("other variables") == ["bridge.one", "bridge.two"]
    monkeypatch.delenv("MIDSPAN_KERNEL_CACHE")
    assert compiled("no cache") == ["bridge.one", "bridge.two"]


def pretend_to_compile(build: Any) -> None:
    for extension in build.extensions:
        build.compiled.append(extension.name)
        target = Path(build.build_lib) / build.get_ext_filename(extension.name)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(extension.sources[0], target)


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a tree with one compiled kernel."""
    monkeypatch.setattr(kernels, "ROOT", tmp_path)
    monkeypatch.setattr(kernels, "KERNELS", ("bridge.one",))
    monkeypatch.setattr(kernels, "C_MODULES", ())
    folder = tmp_path / "bridge"
    folder.mkdir()
    (folder / "one.py").write_text("X = 1\n", encoding="utf-8")
    for name in ("one", kernels.SHARED.rpartition(".")[2]):
        (folder / f"{name}.abi3.so").write_bytes(b"compiled")
    version = kernels.compiler_version()
    known = {name: kernels.digest(name, version) for name in ("bridge.one", kernels.SHARED)}
    (folder / kernels.RECORD).write_text(json.dumps({**known, "cython": version}), encoding="utf-8")
    return folder


def test_a_complete_build_is_ok(tree: Path) -> None:
    assert kernels.state().ok
    assert only(machine.check_kernels(around())).result is Result.OK


def test_a_build_of_other_sources_is_reported(tree: Path) -> None:
    (tree / "one.py").write_text("X = 2\n", encoding="utf-8")
    assert kernels.state().stale == ("bridge.one",)
    finding = only(machine.check_kernels(around()))
    assert finding.result is Result.WARN
    assert "make setup" in finding.cure


def test_a_build_with_other_flags_is_reported(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "FLAGS", ("-O0",))
    assert kernels.state().stale == ("bridge.one", kernels.SHARED)


def test_a_build_by_another_cython_is_reported(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "compiler_version", lambda: "3.99")
    assert kernels.state().stale == ("bridge.one", kernels.SHARED)


def test_a_machine_without_cython_trusts_the_record(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "compiler_version", lambda: "")
    assert kernels.state().ok


@pytest.mark.parametrize("record", ["", "[]", "{", '{"bridge.one": 1}'])
def test_a_record_without_digests_means_a_stale_build(tree: Path, record: str) -> None:
    (tree / kernels.RECORD).write_text(record, encoding="utf-8")
    assert kernels.state().stale == ("bridge.one", kernels.SHARED)


def test_missing_kernels_are_reported(tree: Path) -> None:
    shutil.rmtree(tree)
    tree.mkdir()
    (tree / "one.py").write_text("X = 1\n", encoding="utf-8")
    assert kernels.state().missing == ("bridge.one", kernels.SHARED)
    finding = only(machine.check_kernels(around()))
    assert finding.result is Result.FAIL
    assert "refuse goals" in finding.seen
    assert "g++" in finding.cure


@pytest.mark.parametrize(
    ("missing", "refused"),
    [
        (kernels.C_MODULES, False),
        (("navigation.algorithms.voxel_map", "sim.laser_kernel"), False),
        (("navigation.algorithms.stopping", *kernels.C_MODULES), True),
        ((kernels.SHARED,), True),
    ],
)
def test_goals_are_refused_only_without_a_kernel_for_driving(
    missing: tuple[str, ...], refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels, "state", lambda: kernels.KernelState(missing, ()))
    assert bool(not_compiled()) is refused
    assert kernels.C_MODULES[0] not in not_compiled()
    finding = only(machine.check_kernels(around()))
    assert finding.result is Result.FAIL
    assert ("refuse goals" in finding.seen) is refused


def test_the_kernels_for_driving_are_those_that_its_modules_import() -> None:
    code = (
        "import sys, navigation.robot_goto.module, navigation.robot_path_planner.module; from bridge import kernels;"
        "print(*set(kernels.KERNELS) & set(sys.modules))"  # the modules in C have a replacement in Python
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=kernels.ROOT, capture_output=True, text=True, check=True)
    assert {*done.stdout.split(), kernels.SHARED} == set(kernels.DRIVING)
