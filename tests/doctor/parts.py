"""What the doctor's tests share."""

from __future__ import annotations

from typing import Any

from bridge.config.model import Config
from bridge.doctor.around import Around, HubView
from bridge.doctor.finding import Finding, Result


def around(config: dict[str, Any] | None = None, environ: dict[str, str] | None = None, **more: Any) -> Around:
    """Surroundings with nothing in the environment but what is given."""
    return Around(Config.model_validate({"name": "robot1", **(config or {})}), environ=environ or {}, **more)


def hub(*documents: dict[str, Any], **more: Any) -> HubView:
    """A hub with these workers."""
    return HubView(documents=[{"daemon": "robot1", "routes": [], "refused": [], **d} for d in documents], **more)


def results(findings: Any) -> list[Result]:
    """The findings' results."""
    return [finding.result for finding in findings]


def only(findings: Any) -> Finding:
    """The one finding that there must be."""
    (finding,) = findings
    assert isinstance(finding, Finding)
    return finding
