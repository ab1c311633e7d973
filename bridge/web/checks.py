"""The doctor's check of the console: its certificate, and access from other machines."""

from __future__ import annotations

from pathlib import Path

from bridge.doctor.check import Check, Finding, Findings, fail, ok, outdated_cure, skip, warn
from bridge.doctor.context import CheckContext
from bridge.hub.security.certificates import Certificate, CertificateError, read_certificate, trouble
from bridge.hub.security.external_router import key_files
from bridge.metrics.section import MetricsSection
from bridge.web.section import WebSection

SOON_DAYS = 30
_COPY = "correct the files, and copy them here; see docs/operate/console.md"
_MAKE = "'midspan keys make' creates the files; see docs/operate/console.md"


def check_certificate(context: CheckContext) -> Findings:
    """Check the files of the console's TLS: present, readable, of one authority, valid, and protected."""
    web, metrics = context.config.section(WebSection), context.config.section(MetricsSection)
    if not (web.enabled and web.guarded) and not (metrics.enabled and metrics.reached):
        return skip("no certificate is needed, because console and metrics are off, or listen only on loopback")
    files = key_files(context.config)
    what = "the console" if web.enabled else "the worker metrics"
    reason = trouble(files) or files.trouble()
    if reason:
        if expired := _expired(files.certificate):
            seen = f"{expired.outdated()}: browsers refuse it, and {what} does not start with it"
            return fail(seen, outdated_cure(expired.renewal))
        return fail(f"{what} cannot start: {reason}", _COPY if files.certificate.exists() else _MAKE)
    certificate = read_certificate(files.certificate)
    findings: list[Finding] = []
    if certificate.begins_later():
        findings.append(fail(f"{certificate.outdated()}: browsers refuse it", outdated_cure(certificate.renewal)))
    elif certificate.days_left() < SOON_DAYS:
        seen = f"{certificate.title} expires in {certificate.days_left()} days, and browsers refuse it then"
        findings.append(warn(seen, f"{certificate.renewal}, then copy the files; the console loads them by itself"))
    if files.others_may_use_key():
        findings.append(warn(f"other users can read {files.key}, and pose as this console", f"chmod 600 {files.key}"))
    strange = [name for name in web.names if name not in certificate.names]
    if strange:
        cure = f"'midspan keys make {certificate.name} {' '.join(web.names)} --replace'"
        findings.append(warn(f"browsers warn about {', '.join(strange)}: not in {certificate.file}", cure))
    return findings or ok(
        f"browsers accept the console as {', '.join(web.names or certificate.names)} until {certificate.until:%Y-%m-%d}"
    )


def _expired(file: Path) -> Certificate | None:
    """Return a certificate that has expired by this machine's clock, None if it has not, or cannot be read."""
    try:
        certificate = read_certificate(file)
    except CertificateError:
        return None
    return certificate if certificate.outdated() and not certificate.begins_later() else None


CHECKS = (Check("console", "the certificate of the console (`web`)", check_certificate),)
