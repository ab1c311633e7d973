"""The keys by which machines join the hub (``hub.open``)."""

from __future__ import annotations

from bridge.doctor.check import Finding, Findings, fail, ok, outdated_cure, skip, warn
from bridge.doctor.context import CheckContext
from bridge.hub.errors import HubConfigError
from bridge.hub.security.certificates import Certificate, CertificateError, read_certificate, signer
from bridge.hub.security.external_router import has_tls, key_files
from bridge.hub.security.key_files import KeyFiles
from bridge.status import RouterStatus

SOON_DAYS = 30


def check_keys(context: CheckContext) -> Findings:
    """Check that the files of ``hub.open`` are readable, belong together and to this machine, and stay valid."""
    if not has_tls(context.config.hub.open):
        return skip("hub.open names no endpoint with TLS: no certificate is needed")
    files = key_files(context.config)
    try:
        files.check()
        certificate, authority = read_certificate(files.certificate), signer(files.certificate, files.ca)
    except (HubConfigError, CertificateError) as err:
        return fail(str(err), "'midspan keys make' makes the files; see docs/operate/security.md")
    findings = [
        *_validity(certificate),
        *_validity(authority or read_certificate(files.ca)),
        *_unusable(files),
        *_key_mode(files),
        *_untrusted(certificate.name, context),
    ]
    if authority is None:
        cure = "copy both from the same folder of 'midspan keys'"
        findings.append(fail(f"{files.certificate} was not signed by {files.ca}", cure))
    if certificate.name != context.config.name:
        seen = f"this machine's certificate has the name {certificate.name!r}, not {context.config.name!r}"
        findings.append(warn(f"{seen}; other machines trust the former", "use one name in both; see the key 'name'"))
    return findings or ok(f"other machines know this one as {certificate.name}, until {certificate.until:%Y-%m-%d}")


def _untrusted(name: str, context: CheckContext) -> list[Finding]:
    """Return a warning for each daemon that accepts no commands from this machine."""
    return [
        warn(
            f"{document.daemon} accepts no commands, goals or service calls from this machine",
            f"if that is not intended, name {name!r} in hub.open.trusted there",
        )
        for document in context.hub.documents
        if isinstance(document, RouterStatus)
        for machine in document.machines
        if machine.name == name and not machine.trusted
    ]


def _validity(certificate: Certificate) -> list[Finding]:
    """Return a finding if a certificate is not valid yet, has expired, or expires soon."""
    loads = "the router loads them without a restart"
    if outdated := certificate.outdated():
        return [fail(f"{outdated}: no machine accepts it", f"{outdated_cure(certificate.renewal)}; {loads}")]
    left = certificate.days_left()
    if left < SOON_DAYS:
        seen = f"{certificate.title} expires on {certificate.until:%Y-%m-%d}, in {left} days"
        return [warn(seen, f"{certificate.renewal}, then copy the files; {loads}")]
    return []


def _unusable(files: KeyFiles) -> list[Finding]:
    trouble = files.trouble()
    return [fail(trouble, "copy both from the same folder of 'midspan keys'")] if trouble else []


def _key_mode(files: KeyFiles) -> list[Finding]:
    if not files.others_may_use_key():
        return []
    return [warn(f"other users can use {files.key} to impersonate this machine", f"chmod 600 {files.key}")]
