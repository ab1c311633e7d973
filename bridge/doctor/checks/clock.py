"""Do the clocks of the machines agree? Time stamps, transforms and latencies are worth no more than that."""

from __future__ import annotations

from collections.abc import Sequence

from bridge.doctor.around import Around
from bridge.doctor.finding import Finding, fail, ok, skip, warn

WARN_SECONDS = 0.02
"""Transforms of a moving robot are usually looked up within some tens of milliseconds."""
FAIL_SECONDS = 0.5
_CURE = "synchronise them: apt install chrony on both machines, one of them serving the time to the other"


def look(around: Around) -> Sequence[Finding]:
    """One finding for each daemon whose clock differs."""
    if not around.hub.clocks:
        return [skip("no worker tells its time")]
    findings: list[Finding] = []
    daemons: dict[str, tuple[float, float]] = {}
    for name, offset in around.hub.clocks.items():
        daemon = name.partition("/")[0]
        if daemon not in daemons or offset.error < daemons[daemon][1]:
            daemons[daemon] = (offset.seconds, offset.error)
    for daemon, (seconds, error) in sorted(daemons.items()):
        sure = max(abs(seconds) - error, 0.0)
        way = "ahead of" if seconds > 0 else "behind"
        text = f"{daemon}'s clock is {abs(seconds) * 1e3:.1f} ms {way} this machine's (within {error * 1e3:.1f} ms)"
        if sure > FAIL_SECONDS:
            findings.append(fail(text, _CURE))
        elif sure > WARN_SECONDS:
            findings.append(warn(text, _CURE))
    return findings or [ok(f"the clocks of {', '.join(sorted(daemons))} agree with this machine's")]
