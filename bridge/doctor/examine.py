"""Runs the checks, all at once, each within its time."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from bridge.doctor.around import Around
from bridge.doctor.finding import Check, Finding, fail

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Report:
    """What one check found."""

    check: Check
    findings: Sequence[Finding] = ()
    done: threading.Event = field(default_factory=threading.Event)


def examine(around: Around, checks: Sequence[Check]) -> list[Report]:
    """Run all checks, in threads of their own; one that hangs is given up and said to."""
    started = time.monotonic()
    reports = [Report(check) for check in checks]
    for report in reports:
        # daemon threads: what hangs in the system's resolver must not keep the command from ending
        threading.Thread(target=_run, args=(around, report), name=f"doctor-{report.check.id}", daemon=True).start()
    for report in reports:
        left = started + report.check.seconds - time.monotonic()
        if not report.done.wait(max(left, 0.0)):
            report.findings = [fail(f"no answer within {report.check.seconds:g} s; what it looks at hangs")]
    return reports


def _run(around: Around, report: Report) -> None:
    try:
        findings = report.check.look(around)
    except Exception as err:
        _log.debug("check %s failed", report.check.id, exc_info=err)
        findings = [fail(f"the check itself failed: {type(err).__name__}: {err}")]
    if not report.done.is_set():
        report.findings = findings
        report.done.set()
