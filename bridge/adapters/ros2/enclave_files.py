"""The files of an SROS 2 enclave, and whether they allow to join a domain.

rmw reads these files (rmw_dds_common, security.cpp). Fast DDS only logs why it refuses them, so the likely reasons are
checked; the signatures of the governance and the permissions are not.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

GOVERNANCE, _PERMISSIONS = "governance.p7s", "permissions.p7s"
AUTHORITIES = ("identity_ca.cert.pem", "permissions_ca.cert.pem")
_CERTIFICATES, _KEY = ("identity_ca.cert", "cert", "permissions_ca.cert"), "key"
_LARGEST = 1 << 20
_XML = re.compile(rb"<dds\b.*?</dds>", re.DOTALL)


class EnclaveError(Exception):
    """A file of the enclave cannot be used; the text is the reason. ``file``, or the folder, must be created again."""

    def __init__(self, text: str, file: Path) -> None:
        super().__init__(text)
        self.file = file


def check(folder: Path, domain: int) -> None:
    """Raise `EnclaveError` or `OSError` if the files of an enclave do not allow to join a domain now."""
    # .p11: a PKCS #11 URI, whose token is not checked
    files = [folder / f"{name}.pem" for name in (*_CERTIFICATES, _KEY) if not (folder / f"{name}.p11").is_file()]
    contents = {file.stem: _read(file) for file in files}
    certificates = {file.stem: _certificates(file, contents[file.stem]) for file in files if file.stem != _KEY}
    subject = _check_identity(folder, certificates, contents.get(_KEY))
    governance, permissions = folder / GOVERNANCE, folder / _PERMISSIONS
    _check_domain(governance, _document(governance).findall(".//domain_rule"), domain)
    grants = _document(permissions).findall(".//grant")
    own = [grant for grant in grants if not subject or grant.findtext("subject_name", "").strip() == subject]
    if subject and not own:
        text = f"{permissions} has no grant for {subject}, the subject of {folder / 'cert.pem'}"
        raise EnclaveError(text, folder)
    for grant in own:
        _check_validity(permissions, grant)
    _check_domain(permissions, [rule for grant in own for rule in grant.findall("allow_rule")], domain)


def _check_validity(file: Path, grant: ET.Element) -> None:
    """Raise `EnclaveError` unless a grant of the permissions is valid now."""
    now = datetime.now(UTC)
    since, until = (_time(grant.findtext(f"validity/{name}", "")) for name in ("not_before", "not_after"))
    if until is not None and until < now:
        raise EnclaveError(f"the permissions {file} have expired on {until:%Y-%m-%d}", file)
    if since is not None and since > now:
        text = f"the permissions {file} are valid only from {since:%Y-%m-%d}: is this machine's clock right"
        raise EnclaveError(text, file)


def _time(text: str) -> datetime | None:
    try:
        time = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return time if time.tzinfo else time.replace(tzinfo=UTC)


def _read(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(_LARGEST)


def _certificates(file: Path, content: bytes) -> list[Certificate]:
    """Return the certificates in a file, of which the first must be valid now."""
    from cryptography import x509  # only a secured domain needs it

    try:
        certificates = x509.load_pem_x509_certificates(content)
    except ValueError:
        raise EnclaveError(f"{file} is not a certificate in PEM format", file) from None
    now, until, since = datetime.now(UTC), certificates[0].not_valid_after_utc, certificates[0].not_valid_before_utc
    if until < now:
        raise EnclaveError(f"the certificate {file} has expired on {until:%Y-%m-%d}", file)
    if since > now:
        text = f"the certificate {file} is valid only from {since:%Y-%m-%d}: is this machine's clock right"
        raise EnclaveError(text, file)
    return certificates


def _check_identity(folder: Path, certificates: Mapping[str, Sequence[Certificate]], key: bytes | None) -> str:
    """Raise `EnclaveError` if the enclave's key or authority does not fit its certificate.

    Returns the certificate's subject as the permissions name it, or "" if its form differs from that of the subjects of
    ``ros2 security``, which consist of one common name.
    """
    if "cert" not in certificates:
        return ""
    from cryptography.x509 import NameOID

    certificate = certificates["cert"][0]
    if key is not None:
        _check_key(folder / "key.pem", key, certificate)
    authorities = certificates.get("identity_ca.cert")
    if authorities is not None and not any(_is_issued_by(certificate, authority) for authority in authorities):
        text = f"the authority in {folder / 'identity_ca.cert.pem'} did not issue {folder / 'cert.pem'}"
        raise EnclaveError(text, folder)
    names = [attribute for rdn in certificate.subject.rdns for attribute in rdn]
    is_common_name = len(names) == 1 and names[0].oid == NameOID.COMMON_NAME
    return f"CN={names[0].value!s}" if is_common_name else ""


def _is_issued_by(certificate: Certificate, authority: Certificate) -> bool:
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm

    try:
        certificate.verify_directly_issued_by(authority)
    except UnsupportedAlgorithm:  # it cannot be checked here
        return True
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def _check_key(file: Path, content: bytes, certificate: Certificate) -> None:
    """Raise `EnclaveError` if a file has no private key, or that of another certificate."""
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(content, None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as err:
        raise EnclaveError(f"{file} is not a private key in PEM format without a password: {err}", file) from None
    if key.public_key() != certificate.public_key():
        raise EnclaveError(f"{file} is not the private key of {file.parent / 'cert.pem'}", file.parent)


def _document(file: Path) -> ET.Element:
    """Return the XML document in a file that the permissions authority has signed (S/MIME, in clear text)."""
    text = _XML.search(_read(file))
    try:
        return ET.fromstring(text[0] if text else b"")  # noqa: S314 - a file of the keystore, of limited size
    except ET.ParseError as err:
        raise EnclaveError(f"{file} is not a signed document of DDS Security: {err}", file) from None


def _check_domain(file: Path, rules: list[ET.Element], domain: int) -> None:
    """Raise `EnclaveError` if none of the rules is for the domain."""
    ranges: list[tuple[int, int]] = []
    for domains in (found for rule in rules for found in rule.findall("domains")):
        ids = [domains.findall("id"), domains.findall("id_range/min"), domains.findall("id_range/max")]
        try:
            ones, least, most = ([int(element.text or "") for element in elements] for elements in ids)
        except ValueError:
            return
        ranges += [*zip(ones, ones, strict=True)]
        if len(least) != len(most):  # an open range
            return
        ranges += [*zip(least, most, strict=True)]
    if ranges and not any(first <= domain <= last for first, last in ranges):
        texts = [f"{first}" if first == last else f"{first} to {last}" for first, last in ranges]
        allowed = ", ".join(dict.fromkeys(texts))
        raise EnclaveError(f"{file} is for domain {allowed}, but Midspan's is {domain}", file)
