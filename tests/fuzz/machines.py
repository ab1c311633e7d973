"""``python -m tests.fuzz.machines FORM ...``: fuzz the conversion machine in a form other than the installed one.

``python`` runs it uncompiled, so that an access out of bounds is an IndexError; ``sanitized`` compiles it with
AddressSanitizer and a check of alignment, which abort the process. Further arguments are passed to ``python -m
tests.fuzz``.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import subprocess
import sys
import sysconfig
import tempfile
from functools import cache
from pathlib import Path

from bridge import kernels

_NAME = "bridge.messages.transcode.vm"
_FILE = "MIDSPAN_FUZZED_MACHINE"
_SANITIZERS = ["-fsanitize=address,alignment", "-fno-sanitize-recover=alignment"]
_FLAGS = ["-O1", "-g", "-fno-omit-frame-pointer", *_SANITIZERS, "-DPy_LIMITED_API=0x030b0000"]
_library = ctypes.CDLL(None)


def main() -> int:
    """Build the requested form, and fuzz it."""
    form, *arguments = sys.argv[1:] or [""]
    if form not in ("python", "sanitized"):
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory(prefix="midspan-fuzz-") as folder:
        source = kernels.source(_NAME)
        file = source if form == "python" else sanitized(source, Path(folder))
        command = [sys.executable, "-m", "tests.fuzz", *arguments]
        return subprocess.run(command, env=environment(file), check=False).returncode


def sanitized(source: Path, folder: Path) -> Path:
    """Compile a source of the machine with the sanitizers; setup.py cannot compile a single kernel."""
    code, library = folder / "machine.c", folder / "machine.abi3.so"
    cython = [sys.executable, "-m", "cython", "-3", "--module-name", _NAME, str(source), "-o", str(code)]
    compiler = [*sysconfig.get_config_var("CC").split(), "-shared", "-fPIC", *_FLAGS]
    include = f"-I{sysconfig.get_path('include')}"
    for command in (cython, [*compiler, include, str(code), "-o", str(library)]):
        subprocess.run(command, check=True, capture_output=True)
    return library


def environment(file: Path) -> dict[str, str]:
    """Return the environment of a fuzzing process that loads the machine from a file."""
    variables = {**os.environ, _FILE: str(file)}
    if file.suffix == ".py":
        return variables
    library = subprocess.run(["gcc", "-print-file-name=libasan.so"], check=True, capture_output=True, text=True)
    return {
        **variables,
        "LD_PRELOAD": library.stdout.strip(),
        "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=1:quarantine_size_mb=16:allocator_may_return_null=1",
        "PYTHONMALLOC": "malloc",  # puts a red zone around each object
    }


def load() -> None:
    """Load the machine from the file that the environment names, before another module imports it."""
    file = os.environ.get(_FILE)
    if file:
        spec = importlib.util.spec_from_file_location(_NAME, file)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[_NAME] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[_NAME])


@cache
def is_sanitized() -> bool:
    """Return whether this process uses AddressSanitizer, which reserves more addresses than a memory limit allows."""
    return hasattr(_library, "__asan_poison_memory_region")


def guard(message: bytes) -> None:
    """Poison the NUL that Python appends to bytes, so that AddressSanitizer detects the first byte out of bounds."""
    if is_sanitized() and len(message) > 1:  # shorter objects are shared
        start = ctypes.cast(message, ctypes.c_void_p).value
        assert start is not None
        _library.__asan_poison_memory_region(ctypes.c_void_p(start + len(message)), ctypes.c_size_t(1))


if __name__ == "__main__":
    sys.exit(main())
