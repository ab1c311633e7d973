"""What of Midspan's libraries is not published for this system, and which side is not to be had for it."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping, Sequence

from packaging.markers import default_environment
from packaging.requirements import Requirement

from bridge.daemon.workers import worker_kinds
from bridge.doctor.around import Around
from bridge.doctor.finding import Finding, fail, ok, skip, warn


def look(around: Around) -> Sequence[Finding]:
    """Are there wheels of everything for this system, or else the side's packages in another way?"""
    try:
        requirements = importlib.metadata.requires("midspan") or []
    except importlib.metadata.PackageNotFoundError:
        return [skip("Midspan is not installed as a package: run make setup, or pip install")]
    environment = {name: str(value) for name, value in default_environment().items()}
    return compare(around, requirements, environment)


def compare(around: Around, requirements: Sequence[str], environment: Mapping[str, str]) -> Sequence[Finding]:
    """What the requirements leave out on a system; an extra is named for the side that needs it."""
    system = f"{environment['sys_platform']}, {environment['platform_machine']}"
    kinds = worker_kinds()
    findings: list[Finding] = []
    for side, names in left_out(requirements, environment).items():
        kind = kinds.get(side)
        if kind is None or kind.enabled(around.config) is False:
            continue
        seen = f"no wheel on this system ({system}): {', '.join(names)}"
        if not kind.missing(around.config):
            findings.append(ok(f"{seen}; side {side} uses what is installed"))
            continue
        tell = fail if kind.enabled(around.config) is True else warn
        cure = f"run 'midspan worker {side}' on a machine that has them, in the same hub; here {side}.enabled: false"
        findings.append(tell(f"{seen}; so side {side} is not available", cure))
    return findings or [ok(f"there are wheels of everything for this system ({system})")]


def left_out(requirements: Sequence[str], environment: Mapping[str, str]) -> dict[str, list[str]]:
    """By extra, the requirements whose markers leave them out on a system, as lists of names."""
    found: dict[str, list[str]] = {}
    for requirement in map(Requirement, requirements):
        marker = requirement.marker
        extra = extra_of(str(marker)) if marker is not None else ""
        if marker is not None and not marker.evaluate({**environment, "extra": extra}):
            found.setdefault(extra, []).append(requirement.name)
    return found


def extra_of(marker: str) -> str:
    """The extra that a requirement in a package's metadata belongs to, "" where to none."""
    _, _, rest = marker.partition('extra == "')
    return rest.partition('"')[0]
