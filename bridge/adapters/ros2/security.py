"""SROS 2: the enclave of the side's participant, and why it cannot join a secured domain.

rcl reads these variables when it creates the context (rcl, security.c). With the strategy Permissive the participant
would join unsecured if its enclave is missing, so the enclave is checked for both strategies. rmw reads the files of
the enclave (rmw_dds_common, security.cpp). Fast DDS only logs why it refuses them, so the likely reasons are checked.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree as ET

ENABLE = "ROS_SECURITY_ENABLE"
KEYSTORE, OVERRIDE = "ROS_SECURITY_KEYSTORE", "ROS_SECURITY_ENCLAVE_OVERRIDE"
_ENCLAVE = "/midspan"

_CERTIFICATES = ("identity_ca.cert", "cert", "permissions_ca.cert")
_AUTHORITIES = ("identity_ca.cert.pem", "permissions_ca.cert.pem")
_GOVERNANCE, _PERMISSIONS = "governance.p7s", "permissions.p7s"
_LARGEST = 1 << 20
_XML = re.compile(rb"<dds\b.*?</dds>", re.DOTALL)


class _FileError(Exception):
    """A file of the enclave cannot be used; the text is the reason. ``file`` must be made again."""

    def __init__(self, text: str, file: Path) -> None:
        super().__init__(text)
        self.file = file


def enclave(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the variable that gives a worker in a secured domain its own enclave; a value that is set is kept."""
    return {OVERRIDE: environ.get(OVERRIDE) or _ENCLAVE} if is_enabled(environ) else {}


def is_enabled(environ: Mapping[str, str]) -> bool:
    """Return whether the programs of an environment join secured domains; rcl accepts only ``true``."""
    return environ.get(ENABLE) == "true"


def refusal(environ: Mapping[str, str]) -> str:
    """Return the likely cure if DDS refuses an endpoint in a secured domain; "" outside of one."""
    if not is_enabled(environ):
        return ""
    return f"allow it in the permissions of the enclave {enclave(environ)[OVERRIDE]} (ros2 security create_permission)"


def trouble(environ: Mapping[str, str], domain: int, *, wheels: bool) -> str:
    """Return why the side cannot join a secured domain, and the cure; "" if it can, or if none is wanted.

    With ``wheels`` Fast DDS comes from the wheels, which are built without DDS Security.
    """
    if not is_enabled(environ):
        return ""
    if wheels:
        return (
            f"{ENABLE} is true, but the Fast DDS of the wheels is built without DDS Security; source an installed"
            f" ROS 2, which has it, before Midspan's daemon starts, or unset {ENABLE}"
        )
    keystore, name = environ.get(KEYSTORE, ""), enclave(environ)[OVERRIDE]
    if not keystore:
        return f"{ENABLE} is true, but {KEYSTORE} is not set; set it to the folder that 'ros2 security' created"
    if not name.startswith("/"):
        return f"{OVERRIDE} is {name}, but the name of an enclave begins with a slash; set it to /{name}"
    folder = Path(keystore) / "enclaves" / name.strip("/")
    create = f"'{_tool(domain)} create_enclave {keystore} {name}'"
    try:
        if not folder.is_dir():
            return f"the keystore {keystore} has no enclave {name}; {create}"
        _check_files(folder, domain)
    except FileNotFoundError as err:
        return f"{err.filename} is missing; {create}"
    except OSError as err:
        reason = f"cannot read {err.filename or folder}: {err.strerror}"
        return f"{reason}; the user of Midspan's daemon needs read access to the enclave's files"
    except _FileError as err:
        return f"{err}; {_replacement(err.file, Path(keystore), domain) or f'remove it, then {create}'}"
    return ""


def _tool(domain: int) -> str:
    return f"ROS_DOMAIN_ID={domain} ros2 security"


def _replacement(file: Path, keystore: Path, domain: int) -> str:
    """Return how to replace a file of the whole keystore; "" for a file of one enclave."""
    if file.name == _GOVERNANCE:
        documents = f"governance.xml and {_GOVERNANCE} in {keystore / 'enclaves'}"
        return f"remove {documents}, then '{_tool(domain)} create_keystore {keystore}'"
    if file.name in _AUTHORITIES:
        return f"create a new keystore with new enclaves: '{_tool(domain)} create_keystore FOLDER'"
    return ""


def _check_files(folder: Path, domain: int) -> None:
    """Raise `_FileError` or `OSError` if the files of an enclave do not allow to join a domain now."""
    for name in (*_CERTIFICATES, "key"):
        if not (folder / f"{name}.p11").is_file():  # a PKCS #11 URI, whose token is not checked
            content = _read(folder / f"{name}.pem")
            if name in _CERTIFICATES:
                _check_certificate(folder / f"{name}.pem", content)
    governance, permissions = folder / _GOVERNANCE, folder / _PERMISSIONS
    _check_domain(governance, _document(governance).findall(".//domain_rule"), domain)
    grants, now = _document(permissions).findall(".//grant"), datetime.now(UTC)
    for grant in grants:
        until = grant.findtext("validity/not_after", "")
        try:
            end = datetime.fromisoformat(until.strip())
        except ValueError:
            continue
        if (end if end.tzinfo else end.replace(tzinfo=UTC)) < now:
            raise _FileError(f"the permissions {permissions} have expired on {end:%Y-%m-%d}", permissions)
    _check_domain(permissions, [rule for grant in grants for rule in grant.findall("allow_rule")], domain)


def _read(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(_LARGEST)


def _check_certificate(file: Path, content: bytes) -> None:
    from cryptography import x509  # only a secured domain needs it

    try:
        certificate = x509.load_pem_x509_certificate(content)
    except ValueError:
        raise _FileError(f"{file} is not a certificate in PEM format", file) from None
    now = datetime.now(UTC)
    if certificate.not_valid_after_utc < now:
        raise _FileError(f"the certificate {file} has expired on {certificate.not_valid_after_utc:%Y-%m-%d}", file)
    if certificate.not_valid_before_utc > now:
        since = f"{certificate.not_valid_before_utc:%Y-%m-%d}"
        raise _FileError(f"the certificate {file} is valid only from {since}: is this machine's clock right", file)


def _document(file: Path) -> ET.Element:
    """Return the XML document in a file that the permissions authority has signed (S/MIME, in clear text)."""
    text = _XML.search(_read(file))
    try:
        return ET.fromstring(text[0] if text else b"")  # noqa: S314 - a file of the keystore, of limited size
    except ET.ParseError as err:
        raise _FileError(f"{file} is not a signed document of DDS Security: {err}", file) from None


def _check_domain(file: Path, rules: list[ET.Element], domain: int) -> None:
    """Raise `_FileError` if none of the rules is for the domain."""
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
        allowed = ", ".join(f"{first}" if first == last else f"{first} to {last}" for first, last in ranges)
        raise _FileError(f"{file} is for domain {allowed}, but Midspan's is {domain}", file)
