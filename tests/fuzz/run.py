"""Runs one target on many inputs in this process, which may crash: `tests.fuzz.watch` supervises it."""

from __future__ import annotations

import gc
import math
import mmap
import re
import resource
import struct
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

from tests.fuzz.machines import is_sanitized
from tests.fuzz.mutate import Mutator
from tests.fuzz.target import Subject

MEMORY = 64 << 20
"""Additional memory for one input, bytes."""

SECONDS = 1.0
"""Maximum processor time for one input, seconds; 100 times that of the slowest valid inputs."""

JOURNAL = 1 << 20
JOURNAL_IDLE = (1 << 64) - 1
"""Number in the journal while no input is being run."""

STACKS = "stacks"
"""Name of the file, beside the journal, to which a dying process writes the stacks of its threads."""

TRACE_CHARACTERS = 3000
"""Maximum length of a finding's traceback."""

_HEAD = struct.Struct("<QQ")
_ROUND = 2000
_TRACE_EVERY = 50
_MOST_FINDINGS = 8
_ROOT = str(Path(__file__).parents[2])
_DIGITS = re.compile(r"\d+|'.*'")


@dataclass(frozen=True, slots=True)
class Finding:
    """An input with which a parser broke its contract."""

    signature: str
    content: bytes
    trouble: str


class Journal:
    """The current input, in memory shared with the supervising process."""

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), JOURNAL)

    def write(self, number: int, content: bytes) -> None:
        """Record that input ``number`` begins."""
        size = len(content)
        self._map[_HEAD.size : _HEAD.size + size] = content
        _HEAD.pack_into(self._map, 0, number, size)

    def read(self) -> tuple[int, bytes]:
        """Return the current input with its number."""
        number, size = _HEAD.unpack_from(self._map, 0)
        return number, self._map[_HEAD.size : _HEAD.size + size]


class Fuzzed(NamedTuple):
    """The number of inputs, and one finding for each kind of failure."""

    findings: list[Finding]
    inputs: int


def fuzz(
    subject: Subject, inputs: int, seed: str, journal: Callable[[int, bytes], None], seconds: float = math.inf
) -> Fuzzed:
    """Run a parser on a number of inputs, or fewer if these exceed the processor time in seconds."""
    if not warm(subject):
        _, finding = _give(subject, subject.seeds[0], trace=False)
        reason = f"; the first:\n{finding.trouble}" if finding is not None else ""
        return Fuzzed([Finding("no good seed", subject.seeds[0], f"the target rejects all seeds{reason}")], inputs)
    mutator = Mutator(subject.seeds, subject.tokens, subject.largest, seed)
    findings: dict[str, Finding] = {}
    seen: set[Any] = set()
    end = time.process_time() + seconds
    try:
        for number in range(inputs):
            if number % _ROUND == 0:
                gc.collect()
                limit_memory()
                if time.process_time() > end:
                    return Fuzzed(list(findings.values()), number)
            content = mutator.next()
            journal(number, content)
            new, finding = _give(subject, content, trace=number % _TRACE_EVERY == 0)
            if finding is not None:
                findings.setdefault(finding.signature, finding)
                if len(findings) >= _MOST_FINDINGS:
                    return Fuzzed(list(findings.values()), number + 1)
            elif not new <= seen:
                seen |= new
                mutator.keep(content)
    finally:
        unlimit_memory()
    return Fuzzed(list(findings.values()), inputs)


def _give(subject: Subject, content: bytes, *, trace: bool) -> tuple[set[Any], Finding | None]:
    """Run a parser on one input; return the input's coverage, and a finding if the parser failed."""
    coverage: set[Any] = set()
    begun = time.thread_time()
    try:
        if trace:
            coverage = traced(subject.parse, content, subject.refuses)
        else:
            subject.parse(content)
    except subject.refuses as err:
        coverage = {fingerprint_of(err)}
    except Exception as err:
        return coverage, finding_of(err, content)
    taken = time.thread_time() - begun
    if taken > SECONDS:
        return coverage, Finding("slow", content, f"took {taken:.1f} s of processor time")
    return coverage, None


def warm(subject: Subject) -> bool:
    """Run a parser on its seeds, to load its modules before memory is limited; return whether it accepts any seed."""
    good = [_is_good(subject, content) for content in subject.seeds]
    return any(good)


def _is_good(subject: Subject, content: bytes) -> bool:
    try:
        subject.parse(content)
    except Exception:  # failures are found later, in inputs derived from this seed
        return False
    return True


def limit_memory(extra: int = MEMORY) -> None:
    """Limit the process to this many more bytes; beyond them, allocations raise MemoryError."""
    if is_sanitized():
        return
    pages = int(Path("/proc/self/statm").read_bytes().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + extra, resource.RLIM_INFINITY))


def unlimit_memory() -> None:
    """Remove the memory limit."""
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))


def finding_of(err: BaseException, content: bytes) -> Finding:
    """Return a finding for an unexpected exception, identified by its type and place."""
    frames = traceback.extract_tb(err.__traceback__)
    ours = [f for f in frames if f.filename.startswith(_ROOT)] or frames
    last = ours[-1]
    signature = f"{type(err).__name__} at {Path(last.filename).name}:{last.lineno}"
    return Finding(signature, content, "".join(traceback.format_exception(err))[-TRACE_CHARACTERS:])


def fingerprint_of(err: BaseException) -> int:
    """Return a hash of a rejection's traceback and message, which identifies the input's code path."""
    fingerprint = hash(_DIGITS.sub("", str(err)[:200]))
    place = err.__traceback__
    for _ in range(12):
        if place is None:
            break
        fingerprint = hash((fingerprint, place.tb_lasti))
        place = place.tb_next
    return fingerprint


def traced(parse: Callable[[bytes], object], content: bytes, refuses: tuple[type[Exception], ...]) -> set[Any]:
    """Return the lines of Midspan that an input reaches; slow, so used only for some inputs."""
    lines: set[tuple[CodeType, int]] = set()

    def trace(frame: FrameType, event: str, _arg: Any) -> Any:
        if not frame.f_code.co_filename.startswith(_ROOT):
            return None
        if event == "line":
            lines.add((frame.f_code, frame.f_lineno))
        return trace

    sys.settrace(trace)
    try:
        parse(content)
    except refuses:
        pass
    finally:
        sys.settrace(None)
    return set(lines)
