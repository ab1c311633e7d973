"""What a check of the doctor found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bridge.doctor.around import Around


class Result(StrEnum):
    """How a check went."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    SKIP = "skip"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that a check saw.

    Attributes:
        seen: what was seen, in words.
        cure: what helps, "" where nothing has to be done.
    """

    result: Result
    seen: str
    cure: str = ""


@dataclass(frozen=True, slots=True)
class Check:
    """One check.

    Attributes:
        id: stable name, for scripts and the documentation.
        title: what it looks at.
        look: does it; may block up to ``seconds`` and is given up after that.
    """

    id: str
    title: str
    look: Callable[[Around], Sequence[Finding]]
    seconds: float = 8.0


def ok(seen: str) -> Finding:
    """All is well."""
    return Finding(Result.OK, seen)


def warn(seen: str, cure: str = "") -> Finding:
    """Something that may be meant, or will bite later."""
    return Finding(Result.WARN, seen, cure)


def fail(seen: str, cure: str = "") -> Finding:
    """Something that keeps topics from crossing."""
    return Finding(Result.FAIL, seen, cure)


def skip(seen: str) -> Finding:
    """The check does not apply here."""
    return Finding(Result.SKIP, seen)
