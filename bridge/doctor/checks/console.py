"""The console: whether others can come in to it, where they should."""

from __future__ import annotations

import stat

from bridge.doctor.check import Finding, Findings, fail, ok, skip, warn
from bridge.doctor.checks.hub import early_cure
from bridge.doctor.context import CheckContext
from bridge.hub.security.certificates import read_certificate, trouble
from bridge.hub.security.door import key_files

SOON_DAYS = 30
_MAKE = "'midspan keys make' makes the files; see docs/operate/console.md"


def look_at_certificate(context: CheckContext) -> Findings:
    """The files of the console's TLS: there, readable, of one authority, valid for a while, and nobody else's."""
    web, metrics = context.config.web, context.config.metrics
    if not (web.enabled and web.guarded) and not (metrics.enabled and metrics.reached):
        return skip("console and metrics are on this machine's loopback alone, or off: no certificate is needed")
    files = key_files(context.config)
    why = trouble(files)
    if why:
        return fail(f"{'the console' if web.enabled else 'the worker metrics'} cannot start: {why}", _MAKE)
    own = read_certificate(files.certificate)
    findings: list[Finding] = []
    if own.begins_later():
        seen = f"{own.file} is not valid before {own.since:%Y-%m-%d %H:%M} UTC: browsers refuse it"
        findings.append(fail(seen, early_cure()))
    elif own.days_left() < SOON_DAYS:
        cure = "'midspan keys make NAME --replace', and copy the files; the console takes them up by itself"
        findings.append(warn(f"{own.file} expires in {own.days_left()} days, and browsers refuse it then", cure))
    if files.key.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        findings.append(warn(f"other users may use {files.key}, and pass for this console", f"chmod 600 {files.key}"))
    strange = [name for name in web.names if name not in own.names]
    if strange:
        cure = f"'midspan keys make {own.name} {' '.join(web.names)} --replace'"
        findings.append(warn(f"browsers warn of {', '.join(strange)}: not in {own.file}", cure))
    return findings or ok(
        f"browsers find the console as {', '.join(web.names or own.names)}, until {own.until:%Y-%m-%d}"
    )
