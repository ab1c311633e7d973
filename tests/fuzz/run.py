"""Runs one target over many inputs in this very process, which may die of it: `tests.fuzz.watch` looks after it."""

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
"""Bytes that one input may take, beyond what the process has."""

SECONDS = 1.0
"""Processor time that one input may take; 100 times what the slowest good ones do."""

JOURNAL = 1 << 20
JOURNAL_IDLE = (1 << 64) - 1
"""Number in the journal while no input is under way."""

_HEAD = struct.Struct("<QQ")
_ROUND = 2000
_TRACE_EVERY = 50
_MOST_FINDINGS = 8
_ROOT = str(Path(__file__).parents[2])
_DIGITS = re.compile(r"\d+|'.*'")


@dataclass(frozen=True, slots=True)
class Finding:
    """An input that a parser could not take as it promises."""

    signature: str
    content: bytes
    trouble: str


class Journal:
    """The input under way, in memory shared with the watching process."""

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), JOURNAL)

    def write(self, number: int, content: bytes) -> None:
        """Input ``number`` begins."""
        size = len(content)
        self._map[_HEAD.size : _HEAD.size + size] = content
        _HEAD.pack_into(self._map, 0, number, size)

    def read(self) -> tuple[int, bytes]:
        """The number of the input under way, and the input."""
        number, size = _HEAD.unpack_from(self._map, 0)
        return number, self._map[_HEAD.size : _HEAD.size + size]


class Fuzzed(NamedTuple):
    """How many inputs were given, and what was not taken as promised: one for each kind of failure."""

    findings: list[Finding]
    inputs: int


def fuzz(
    subject: Subject, inputs: int, seed: str, journal: Callable[[int, bytes], None], seconds: float = math.inf
) -> Fuzzed:
    """Give a parser so many inputs, or fewer where these take more than so many seconds of processor time."""
    if not warm(subject):
        return Fuzzed([Finding("no good seed", subject.seeds[0], "the target's seeds are all refused")], inputs)
    mutator = Mutator(subject.seeds, subject.words, subject.largest, seed)
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
            new, found = _give(subject, content, trace=number % _TRACE_EVERY == 0)
            if found is not None:
                findings.setdefault(found.signature, found)
                if len(findings) >= _MOST_FINDINGS:
                    break
            elif not new <= seen:
                seen |= new
                mutator.keep(content)
    finally:
        unlimit_memory()
    return Fuzzed(list(findings.values()), inputs)


def _give(subject: Subject, content: bytes, *, trace: bool) -> tuple[set[Any], Finding | None]:
    """Give a parser one input: what is known of the way that it took, and what went wrong."""
    way: set[Any] = set()
    begun = time.thread_time()
    try:
        if trace:
            way = traced(subject.parse, content, subject.refuses)
        else:
            subject.parse(content)
    except subject.refuses as err:
        way = {way_of(err)}
    except Exception as err:
        return way, finding_of(err, content)
    taken = time.thread_time() - begun
    if taken > SECONDS:
        return way, Finding("slow", content, f"took {taken:.1f} s of processor time")
    return way, None


def warm(subject: Subject) -> bool:
    """Give a parser its good inputs, so that all is loaded before memory is limited; whether it takes any."""
    good = [_is_good(subject, content) for content in subject.seeds]
    return any(good)


def _is_good(subject: Subject, content: bytes) -> bool:
    try:
        subject.parse(content)
    except Exception:  # which of them it may be is seen when inputs are made of it
        return False
    return True


def limit_memory(extra: int = MEMORY) -> None:
    """Let the process have so much more than it has now; beyond, it meets MemoryError."""
    if is_sanitized():
        return
    pages = int(Path("/proc/self/statm").read_bytes().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + extra, resource.RLIM_INFINITY))


def unlimit_memory() -> None:
    """Take the limit off again."""
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))


def finding_of(err: BaseException, content: bytes) -> Finding:
    """An exception that should not be, told by its kind and the place where it was raised."""
    frames = traceback.extract_tb(err.__traceback__)
    ours = [f for f in frames if f.filename.startswith(_ROOT)] or frames
    last = ours[-1]
    signature = f"{type(err).__name__} at {Path(last.filename).name}:{last.lineno}"
    return Finding(signature, content, "".join(traceback.format_exception(err))[-3000:])


def way_of(err: BaseException) -> int:
    """What a refusal tells of the way that an input took: the lines passed on, and the words of the error."""
    way = hash(_DIGITS.sub("", str(err)[:200]))
    place = err.__traceback__
    for _ in range(12):
        if place is None:
            break
        way = hash((way, place.tb_lasti))
        place = place.tb_next
    return way


def traced(parse: Callable[[bytes], object], content: bytes, refuses: tuple[type[Exception], ...]) -> set[Any]:
    """The lines of our code that an input comes along; slow, so that it is asked now and then only."""
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
