"""``python -m tests.fuzz.machines FORM ...``: fuzz another form of the message machine than the one that is installed.

As ``python`` an access out of bounds is an IndexError; ``sanitized`` it is compiled with AddressSanitizer, which ends
the process. What follows goes to ``python -m tests.fuzz``.
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
_FLAGS = ["-O1", "-g", "-fno-omit-frame-pointer", "-fsanitize=address", "-DPy_LIMITED_API=0x030b0000"]
_library = ctypes.CDLL(None)


def main() -> int:
    """Build what is asked for, and fuzz it."""
    form, *arguments = sys.argv[1:] or [""]
    if form not in ("python", "sanitized"):
        sys.exit(__doc__)
    with tempfile.TemporaryDirectory(prefix="midspan-fuzz-") as folder:
        source = kernels.source(_NAME)
        file = source if form == "python" else sanitized(source, Path(folder))
        command = [sys.executable, "-m", "tests.fuzz", *arguments]
        return subprocess.run(command, env=environment(file), check=False).returncode


def sanitized(source: Path, folder: Path) -> Path:
    """Compile a source of the machine with AddressSanitizer; this one kernel alone, which is why setup.py does not."""
    code, made = folder / "machine.c", folder / "machine.abi3.so"
    cython = [sys.executable, "-m", "cython", "-3", "--module-name", _NAME, str(source), "-o", str(code)]
    compiler = [*sysconfig.get_config_var("CC").split(), "-shared", "-fPIC", *_FLAGS]
    include = f"-I{sysconfig.get_path('include')}"
    for command in (cython, [*compiler, include, str(code), "-o", str(made)]):
        subprocess.run(command, check=True, capture_output=True)
    return made


def environment(file: Path) -> dict[str, str]:
    """What a process that fuzzes needs in its environment to take the machine from a file."""
    said = {**os.environ, _FILE: str(file)}
    if file.suffix == ".py":
        return said
    library = subprocess.run(["gcc", "-print-file-name=libasan.so"], check=True, capture_output=True, text=True)
    return {
        **said,
        "LD_PRELOAD": library.stdout.strip(),
        "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=1:quarantine_size_mb=16:allocator_may_return_null=1",
        "PYTHONMALLOC": "malloc",  # each object has forbidden memory around it
    }


def load() -> None:
    """Take the machine from the file that the environment names, before anything else imports it."""
    file = os.environ.get(_FILE)
    if file:
        spec = importlib.util.spec_from_file_location(_NAME, file)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[_NAME] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[_NAME])


@cache
def is_sanitized() -> bool:
    """Whether AddressSanitizer is in this process; it reserves more addresses than any limit allows."""
    return hasattr(_library, "__asan_poison_memory_region")


def guard(message: bytes) -> None:
    """Forbid the NUL that Python keeps behind the bytes, so that AddressSanitizer sees the first byte out of bounds."""
    if is_sanitized() and len(message) > 1:  # objects of one byte or none are everybody's
        start = ctypes.cast(message, ctypes.c_void_p).value
        assert start is not None
        _library.__asan_poison_memory_region(ctypes.c_void_p(start + len(message)), ctypes.c_size_t(1))


if __name__ == "__main__":
    sys.exit(main())
