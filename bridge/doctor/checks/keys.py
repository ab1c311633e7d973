"""Can this machine show who it is to others, and for how long?"""

from __future__ import annotations

import stat
from collections.abc import Sequence

from bridge.doctor.around import Around
from bridge.doctor.finding import Finding, fail, ok, skip, warn
from bridge.hub.authority import Certificate, CertificateError, read_certificate, signed_by
from bridge.hub.door import KeyFiles, has_tls, key_files
from bridge.hub.errors import HubConfigError

SOON_DAYS = 30
_RENEW = "'midspan keys make NAME --replace', and copy the files; the router takes them up by itself"


def look(around: Around) -> Sequence[Finding]:
    """The files of ``hub.open``: there, readable, for this machine, of one authority, and valid for a while."""
    if not has_tls(around.config.hub.open):
        return [skip("hub.open names no endpoint with TLS: no certificate is needed")]
    files = key_files(around.config)
    try:
        files.check()
        own, authority = read_certificate(files.certificate), read_certificate(files.ca)
        signed = signed_by(files.certificate, files.ca)
    except (HubConfigError, CertificateError) as err:
        return [fail(str(err), "'midspan keys make' makes the files, and says where they belong; see docs/security.md")]
    findings = [*_expiry(own), *_expiry(authority), *_mode(files), *_distrust(own.name, around)]
    if not signed:
        findings.append(
            fail(
                f"{files.certificate} was not signed by {files.ca}", "copy both from the same folder of 'midspan keys'"
            )
        )
    if own.name != around.config.name:
        findings.append(
            warn(f"this machine's certificate names it {own.name!r}: others trust it by that name alone", "see 'name'")
        )
    return findings or [ok(f"this machine is {own.name} to others, until {own.until:%Y-%m-%d}")]


def _distrust(name: str, around: Around) -> list[Finding]:
    """The daemons that take no commands from this machine."""
    return [
        warn(
            f"{document.get('daemon')} takes no commands, goals and service calls from this machine",
            f"where that is not meant, name {name!r} in hub.open.trusted there",
        )
        for document in around.hub.documents
        for machine in document.get("machines") or ()
        if machine.get("name") == name and not machine.get("trusted")
    ]


def _expiry(certificate: Certificate) -> list[Finding]:
    left = certificate.days_left()
    if left < 0:
        return [fail(f"{certificate.file} expired on {certificate.until:%Y-%m-%d}: nobody lets it in", _RENEW)]
    if left < SOON_DAYS:
        return [warn(f"{certificate.file} expires in {left} days", _RENEW)]
    return []


def _mode(files: KeyFiles) -> list[Finding]:
    if not files.key.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        return []
    return [warn(f"other users may use {files.key}, and so pass for this machine", f"chmod 600 {files.key}")]
