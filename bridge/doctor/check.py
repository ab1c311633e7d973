"""The doctor's checks and their findings; all checks run at the same time, each with a time limit."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum

from bridge.config.sections.section import Enabled
from bridge.doctor.causes import cause, one_line
from bridge.doctor.context import CheckContext
from bridge.sides import label


class Result(StrEnum):
    """The result of a check."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    SKIP = "skip"


@dataclass(frozen=True, slots=True)
class Finding:
    """What a check found, and the cure ("" if nothing needs to be done)."""

    result: Result
    seen: str
    cure: str = ""


Findings = Finding | Sequence[Finding]


@dataclass(frozen=True, slots=True)
class Check:
    """One check with a stable id; ``run`` is abandoned after ``seconds``."""

    id: str
    title: str
    run: Callable[[CheckContext], Findings]
    seconds: float = 8.0


def ok(seen: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(Result.OK, seen)


def warn(seen: str, cure: str = "") -> Finding:
    """Return a finding that may be intended, or may cause a problem later."""
    return Finding(Result.WARN, seen, cure)


def fail(seen: str, cure: str = "") -> Finding:
    """Return a finding for a problem that keeps something from working."""
    return Finding(Result.FAIL, seen, cure)


def skip(seen: str) -> Finding:
    """Return a finding for a check that does not apply here."""
    return Finding(Result.SKIP, seen)


def packages(side: str, package: str, enabled: Enabled, lacking: str) -> Finding:
    """Report whether a side's package is installed; ``lacking`` is why it cannot be used, "" if it can."""
    name = label(side)
    if enabled is False:
        return skip(f"{side}.enabled is false")
    if not lacking:
        return ok(f"{package} is installed")
    if enabled is True:
        return fail(f"{side}.enabled is true, but {lacking}")
    return warn(f"the {name} side stays off: {lacking}", f"if {name} is not wanted, set {side}.enabled: false")


def outdated_cure(renewal: str) -> str:
    """Return the cure for a certificate that is not valid now; ``renewal`` says how to make a new one."""
    now = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    return f"set this machine's clock if it is not {now} now; if the clock is right: {renewal}, then copy the files"


_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Report:
    """The findings of one check."""

    check: Check
    findings: Sequence[Finding] = ()
    done: threading.Event = field(default_factory=threading.Event)


def examine(context: CheckContext, checks: Sequence[Check]) -> list[Report]:
    """Run all checks, each in its own thread; a check that hangs is reported."""
    started = time.monotonic()
    reports = [Report(check) for check in checks]
    for report in reports:
        # daemon threads: a thread that hangs in the system's resolver must not keep the command from exiting
        threading.Thread(target=_run, args=(context, report), name=f"doctor-{report.check.id}", daemon=True).start()
    for report in reports:
        left = started + report.check.seconds - time.monotonic()
        if not report.done.wait(max(left, 0.0)):
            report.findings = [fail(f"no answer within {report.check.seconds:g} s; the check hangs")]
    return reports


def _run(context: CheckContext, report: Report) -> None:
    try:
        findings = report.check.run(context)
    except Exception as err:
        _log.debug("check %s failed", report.check.id, exc_info=err)
        findings = fail(f"the check itself failed: {type(err).__name__}: {err}")
    if not report.done.is_set():
        report.findings = merged([findings] if isinstance(findings, Finding) else findings)
        report.done.set()


def merged(findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings, with warnings or failures of the same cause and the same cure merged into one."""
    groups: dict[tuple[object, ...], list[Finding]] = {}
    for number, finding in enumerate(findings):
        same = finding.result in (Result.WARN, Result.FAIL)
        key = (finding.result, cause(finding.seen), cause(finding.cure)) if same else (number,)
        groups.setdefault(key, []).append(finding)
    return [replace(group[0], seen=one_line([finding.seen for finding in group])) for group in groups.values()]


def as_json(reports: Sequence[Report]) -> list[dict[str, str]]:
    """Return one entry for each finding: ``check``, ``title``, ``result``, ``seen`` and ``cure``."""
    return [
        {"check": report.check.id, "title": report.check.title, **asdict(finding)}
        for report in reports
        for finding in report.findings
    ]
