"""Compiles the kernels (`bridge.kernels`), into the tree or into a wheel; all other settings are in pyproject.toml.

In the tree only missing or stale kernels are compiled. Without a compiler the kernels run as Python, which set-up and
``midspan doctor`` report. With ``$MIDSPAN_PURE`` none is compiled, for a wheel for any system.
``$MIDSPAN_KERNEL_CACHE`` names a folder of compiled kernels, for machines that build the same sources several times.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import json
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

from Cython import __version__ as cython_version
from Cython.Build import cythonize
from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

HERE = Path(__file__).resolve().parent
GENERATED = Path("build/kernels")
ABI3 = {"py_limited_api": True, "define_macros": [("Py_LIMITED_API", "0x030b0000")]}
"""One build serves every Python from 3.11 on."""


def _load_kernels() -> ModuleType:
    """Load `bridge.kernels` without its package."""
    spec = importlib.util.spec_from_file_location("kernels", HERE / "bridge/kernels.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


kernels = _load_kernels()
SHARED_C = GENERATED / (kernels.SHARED.rpartition(".")[2] + ".c")  # its name is the module's


def _extension(module: str) -> Extension:
    flags = kernels.SHARED_FLAGS if module == kernels.SHARED else kernels.FLAGS
    source = str(SHARED_C if module == kernels.SHARED else kernels.source(module).relative_to(HERE))
    return Extension(module, [source], extra_compile_args=list(flags), optional=True, **ABI3)


@functools.cache
def _toolchain() -> bytes:
    """Describe everything else that a build depends on: compiler, variables, Python, this file.

    Without ``$SOURCE_DATE_EPOCH``, since no source uses ``__DATE__``: a wheel reuses the kernels of the set-up.
    """
    command = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")
    version = subprocess.run([*command, "--version"], capture_output=True, check=False).stdout
    variables = [os.environ.get(name) for name in ("CFLAGS", "CPPFLAGS", "LDFLAGS", "LDSHARED")]
    python = sys.implementation.cache_tag  # the limited API is the same in each build of a Python version
    facts = (command, shutil.which(command[0]), version, variables, python, sysconfig.get_platform())
    return repr(facts).encode() + Path(__file__).read_bytes()


def _cached(module: str) -> Path | None:
    """Return the place of a module's build in the cache; None without a cache."""
    folder = os.environ.get("MIDSPAN_KERNEL_CACHE")
    if not folder:
        return None
    key = hashlib.sha256(kernels.digest(module, cython_version).encode() + _toolchain()).hexdigest()
    return Path(folder) / f"{module}-{key}"


def _replace(source: Path, target: Path) -> None:
    """Copy a file; another process sees either the old or the whole new one."""
    target.parent.mkdir(parents=True, exist_ok=True)
    new = target.with_name(f"{target.name}.{os.getpid()}")
    shutil.copy2(source, new)
    new.replace(target)


class BuildKernels(build_ext):
    """Compiles missing and stale kernels, and records the digests of their sources."""

    def run(self) -> None:
        """Generate C, compile it, and record it."""
        in_tree = bool(self.inplace or getattr(self, "editable_mode", False))
        if in_tree:
            state = kernels.state()
            wanted = {*state.missing, *state.stale}
            self.extensions = [extension for extension in self.extensions if extension.name in wanted]
        root = kernels.ROOT if in_tree else Path(self.build_lib).absolute()
        complete = self.extensions
        self.extensions = [extension for extension in complete if not self._restore(extension.name, root)]
        if self.extensions:
            self.force = True
            self._generate()
            super().run()
            for extension in self.extensions:
                self._store(extension.name, root)
        self.extensions = complete
        self._record(root)

    def _restore(self, module: str, root: Path) -> bool:
        """Copy a module from the cache; return whether it contains the module."""
        cached = _cached(module)
        if cached is None or not cached.is_file():
            return False
        _replace(cached, root / self.get_ext_filename(module))
        return True

    def _store(self, module: str, root: Path) -> None:
        """Copy a compiled module to the cache."""
        cached, built = _cached(module), root / self.get_ext_filename(module)
        if cached is not None and built.is_file():
            _replace(built, cached)

    def _generate(self) -> None:
        GENERATED.mkdir(parents=True, exist_ok=True)
        if any(extension.name == kernels.SHARED for extension in self.extensions):
            command = [sys.executable, "-m", "cython", "-3", f"--generate-shared={SHARED_C}"]
            subprocess.run(command, cwd=HERE, check=True)
        python = [extension for extension in self.extensions if extension.name in kernels.KERNELS]
        others = [extension for extension in self.extensions if extension.name not in kernels.KERNELS]
        self.extensions = others + cythonize(
            python,
            nthreads=min(2, len(python)),
            build_dir=str(GENERATED),
            force=True,
            quiet=True,
            show_all_warnings=False,
            language_level=3,
            shared_utility_qualified_name=kernels.SHARED,
        )
        for extension in self.extensions:  # cythonize creates new extensions
            extension.optional = True
            extension._needs_stub = False

    def build_extension(self, ext: Extension) -> None:
        """Compile a kernel, and report it."""
        sys.stderr.write(f"compiling {ext.name}\n")
        super().build_extension(ext)

    def _record(self, root: Path) -> None:
        """Record the kernels that exist."""
        modules = (*kernels.KERNELS, *kernels.C_MODULES, kernels.SHARED)
        known = dict(kernels.record()) if root == kernels.ROOT else {}
        names = {extension.name for extension in self.extensions}
        for module in modules:
            built = root / self.get_ext_filename(module)
            if not built.is_file():
                known.pop(module, None)
            elif module in names:
                known[module] = kernels.digest(module, cython_version)
        known["cython"] = cython_version
        file = root / "bridge" / kernels.RECORD
        if json.dumps(known) != json.dumps(dict(kernels.record())) or root != kernels.ROOT:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n", encoding="utf-8")


MODULES = () if os.environ.get("MIDSPAN_PURE") else (kernels.SHARED, *kernels.C_MODULES, *kernels.KERNELS)

if __name__ == "__main__":  # processes of Cython that are not forked import this file
    setup(
        ext_modules=[_extension(module) for module in MODULES],
        cmdclass={"build_ext": BuildKernels},
        options={"build_ext": {"parallel": 2}, "bdist_wheel": {"py_limited_api": "cp311"}},
    )
