"""Shared parts of the doctor's tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bridge.config.model import Config
from bridge.doctor.check import Finding, Findings, Result
from bridge.doctor.context import CheckContext, HubSnapshot
from bridge.status import StatusDocument, read_status


def around(config: dict[str, Any] | None = None, environ: dict[str, str] | None = None, **more: Any) -> CheckContext:
    """Return a context whose environment contains only the given variables."""
    return CheckContext(Config.model_validate({"name": "robot1", **(config or {})}), environ=environ or {}, **more)


def hub(*documents: dict[str, Any], **more: Any) -> HubSnapshot:
    """Return a snapshot of a hub with these status documents."""
    return HubSnapshot(documents=[document(d) for d in documents], **more)


def document(fields: dict[str, Any]) -> StatusDocument:
    """Return a status document with these fields."""
    fields = {"daemon": "robot1", "worker": "w", "routes": [], "refused": [], **fields}
    return read_status(fields, fields["daemon"], fields["worker"])


def results(findings: Findings) -> list[Result]:
    """Return the results of the findings."""
    return [finding.result for finding in every(findings)]


def only(findings: Findings) -> Finding:
    """Return the only finding; fail if there are more or none."""
    (finding,) = every(findings)
    return finding


def every(findings: Findings) -> Sequence[Finding]:
    """Return the findings as a list, even if a check returns a single one."""
    return [findings] if isinstance(findings, Finding) else findings
