"""The conversion machine stays within its buffers: it is fuzzed as Python, and compiled with sanitizers.

The sanitizers detect accesses out of bounds and, because some processors refuse them, misaligned accesses.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from bridge import kernels
from tests.fuzz.machines import environment, sanitized
from tests.support.missing import COMPILER, needs

ROOT = Path(__file__).parents[2]
SOURCE = kernels.source("bridge.messages.transcode.vm")
INPUTS = 30_000

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(600),
    needs(COMPILER),
    pytest.mark.skipif(sys.platform != "linux", reason="needs AddressSanitizer"),
]
BROKEN = {
    "reads": ("if i + length > size:", "if i + length > size + 1:"),
    "writes": (
        "elif write:\n                    _copy(source, i, target, o,",
        "elif write:\n                    _copy(source, i, target, o + 2,",
    ),
}
"""A line of the source, and a replacement that is out of bounds by one byte (Python's NUL after the input) or two."""

CUT_SHORT = """
from tests.fuzz.machines import load
load()
from tests.fuzz.targets import TARGETS
subject = TARGETS["machine"].make()
for seed in subject.seeds:
    for end in range(len(seed) - 4, len(seed) + 1):
        try:
            subject.parse(seed[:end])
        except subject.refuses:
            pass
"""


def form(name: str, source: Path, folder: Path) -> Path:
    """Return the machine as Python, or compiled with the sanitizers."""
    return source if name == "python" else sanitized(source, folder)


def run(arguments: list[str], file: Path) -> subprocess.CompletedProcess[str]:
    """Run Python with the machine from a file."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=environment(file),
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


@pytest.mark.parametrize("name", ["python", "sanitized"])
def test_nothing_is_read_or_written_out_of_bounds(name: str, tmp_path: Path):
    targets = [part for target in ("machine", "convert", "any_type") for part in ("--target", target)]
    done = run(
        ["-m", "tests.fuzz", *targets, "--inputs", str(INPUTS), "--save", str(tmp_path)], form(name, SOURCE, tmp_path)
    )
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]


@pytest.mark.parametrize("broken", BROKEN)
@pytest.mark.parametrize("name", ["python", "sanitized"])
def test_accesses_out_of_bounds_are_detected(name: str, broken: str, tmp_path: Path):
    good, bad = BROKEN[broken]
    text = SOURCE.read_text()
    assert text.count(good) == 1
    copy = tmp_path / "vm.py"
    copy.write_text(text.replace(good, bad))
    done = run(["-c", CUT_SHORT], form(name, copy, tmp_path))
    assert done.returncode != 0
    assert ("IndexError: bytes" if name == "python" else "ERROR: AddressSanitizer") in done.stderr


def test_misaligned_accesses_are_detected(tmp_path: Path):
    text, aligned = SOURCE.read_text(encoding="utf-8"), "PyBytes_AsString(program))"
    assert text.count(aligned) == 1
    copy = tmp_path / "vm.py"
    copy.write_text(text.replace(aligned, "PyBytes_AsString(program) + 1)"), encoding="utf-8")
    done = run(["-c", CUT_SHORT], sanitized(copy, tmp_path))
    assert done.returncode != 0
    assert "misaligned address" in done.stderr
