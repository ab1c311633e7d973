"""Certificates that identify machines, issued by one authority for the whole fleet.

The authority's files are ``ca.pem`` and ``ca.key`` in a folder; a machine's files are ``<name>.pem`` and
``<name>.key``. The machine's name is its certificate's common name, which ``hub.open.trusted`` lists. The names and
addresses under which others connect are in its subjectAltName; TLS compares only those.
"""

from __future__ import annotations

import ipaddress
import os
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from bridge.hub.errors import HubConfigError
from bridge.hub.security.key_files import KeyFiles
from yarp_compat.file_names import forbidden

AUTHORITY = "ca"
AUTHORITY_DAYS = 3650
MACHINE_DAYS = 730

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}")
_HOST = re.compile(
    r"(?=.{1,253}$)[A-Za-z0-9_](?:[A-Za-z0-9_-]*[A-Za-z0-9_])?(?:\.[A-Za-z0-9_](?:[A-Za-z0-9_-]*[A-Za-z0-9_])?)*"
)
_MINUTE = "%Y-%m-%d %H:%M UTC"
_EARLIER = timedelta(days=1)
"""Certificates are valid from the day before, for machines whose clocks are slow."""


class CertificateError(Exception):
    """A certificate cannot be created or read; the text is the reason."""


@dataclass(frozen=True, slots=True)
class Certificate:
    """The content of a certificate.

    Attributes:
        names: names and addresses under which others connect.
        authority: whether it may sign other certificates.
    """

    file: Path
    name: str
    issuer: str
    names: tuple[str, ...]
    since: datetime
    until: datetime
    authority: bool

    def days_left(self) -> int:
        """Return the number of days until it expires; negative if it has expired."""
        return (self.until - datetime.now(UTC)).days

    def begins_later(self) -> bool:
        """Return whether it is not valid yet according to this machine's clock."""
        return self.since > datetime.now(UTC)

    @property
    def title(self) -> str:
        """The certificate's owner, if it is in this machine's configuration, and its file."""
        owner = "the authority" if self.authority else "this machine"
        return f"{owner}'s certificate {self.file}"

    def outdated(self) -> str:
        """Return why it is not valid now according to this machine's clock, with the time of its validity; else ""."""
        if self.begins_later():
            return f"{self.title} is not valid before {self.since:{_MINUTE}} (then until {self.until:%Y-%m-%d})"
        if self.until < datetime.now(UTC):
            return f"{self.title} expired on {self.until:{_MINUTE}} (it was valid from {self.since:%Y-%m-%d})"
        return ""

    @property
    def renewal(self) -> str:
        """The command that makes a new certificate in its place, and where to run it."""
        if self.authority:
            return "'midspan keys make NAME --folder DIR' in a new folder makes a new authority; renew all certificates"
        addresses = [name for name in self.names if name not in (self.name, f"{self.name}.local")]
        command = shlex.join(["midspan", "keys", "make", self.name, *addresses, "--replace"])
        return f"'{command}' on the machine with the authority's {AUTHORITY}.key renews it"


class Authority:
    """The authority whose files are in a folder.

    Attributes:
        folder: contains the authority's files and those of the machines.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def exists(self) -> bool:
        """Return whether the authority's certificate or key exists."""
        return (self.folder / f"{AUTHORITY}.pem").exists() or (self.folder / f"{AUTHORITY}.key").exists()

    def make(self, days: int = AUTHORITY_DAYS) -> Certificate:
        """Create the authority.

        Raises `CertificateError` if it exists, because machines would not accept certificates of a second authority,
        or if its files cannot be written.
        """
        if self.exists():
            raise CertificateError(
                f"there is already an authority in {self.folder}; every machine's certificate depends on it"
            )
        key = ec.generate_private_key(ec.SECP256R1())
        name = _x509_name("midspan authority")
        certificate = (
            _builder(name, name, key.public_key(), days)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs=True), critical=True)
            .sign(key, hashes.SHA256())
        )
        return self._write(AUTHORITY, certificate, key)

    def issue(
        self, name: str, names: Sequence[str] = (), days: int = MACHINE_DAYS, *, replace: bool = False
    ) -> Certificate:
        """Create a machine's key and certificate.

        Args:
            name: the machine's name; the certificate is valid for it and for ``<name>.local``.
            names: further host names and IP addresses under which others connect to the machine.
            days: days of validity, limited by the authority's validity.
            replace: replace an existing certificate and key.

        Raises:
            CertificateError: a file already exists or cannot be written, a name is invalid, or the authority cannot be
                used.
        """
        wanted = general_names(name, names)
        existing = [file for file in (self.folder / f"{name}{end}" for end in (".pem", ".key")) if file.exists()]
        if existing and not replace:
            raise CertificateError(f"{existing[0]} already exists; --replace creates a new one in its place")
        signer, signer_key = self._load()
        key = ec.generate_private_key(ec.SECP256R1())
        certificate = (
            _builder(_x509_name(name), signer.subject, key.public_key(), days, signer.not_valid_after_utc)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs=False), critical=True)
            .add_extension(
                x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]),
                critical=False,
            )
            .add_extension(x509.SubjectAlternativeName(wanted), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signer_key.public_key()), critical=False)
            .sign(signer_key, hashes.SHA256())
        )
        return self._write(name, certificate, key)

    def _load(self) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
        file = self.folder / f"{AUTHORITY}.key"
        try:
            certificate = _load(self.folder / f"{AUTHORITY}.pem")[0]
            key = serialization.load_pem_private_key(file.read_bytes(), password=None)
        except (OSError, ValueError, TypeError) as err:
            raise CertificateError(f"the authority's key cannot be used: {err}") from None
        if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
            raise CertificateError(f"{file} is not the key of {AUTHORITY}.pem in the same folder")
        if certificate.not_valid_after_utc < datetime.now(UTC):
            raise CertificateError(
                f"the authority in {self.folder} has expired; create a new one in another folder, and new certificates"
            )
        return certificate, key

    def _write(self, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> Certificate:
        pem, private = self.folder / f"{name}.pem", self.folder / f"{name}.key"
        text = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_private(private, text)
            write_private(pem, certificate.public_bytes(serialization.Encoding.PEM))
        except OSError as err:
            raise CertificateError(f"cannot write into {self.folder}: {err.strerror}") from None
        return read_certificate(pem)


def read_certificate(file: Path) -> Certificate:
    """Return the first certificate in a file; raises `CertificateError` if it cannot be read."""
    return _content(file, _load(file)[0])


def _content(file: Path, certificate: x509.Certificate) -> Certificate:
    try:
        alternatives = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        names = tuple(str(name.value) for name in alternatives)
    except x509.ExtensionNotFound:
        names = ()
    try:
        authority = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    except x509.ExtensionNotFound:
        authority = False
    since, until = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    return Certificate(
        file, _common_name(certificate.subject), _common_name(certificate.issuer), names, since, until, authority
    )


def signer(file: Path, authorities: Path) -> Certificate | None:
    """Return the authority that signed a certificate, None if the file of authorities lacks it.

    The certificate's file may also contain the intermediate authorities between the two (RFC 8446, 4.4.2).

    Raises `CertificateError` if a file cannot be read.
    """
    (certificate, *between), roots = _load(file), _load(authorities)
    while True:
        for root in roots:
            if _signed(certificate, root):
                return _content(authorities, root)
        authorities_between = (other for other in between if _content(file, other).authority)
        issuer = next((other for other in authorities_between if _signed(certificate, other)), None)
        if issuer is None:
            return None
        between.remove(issuer)
        certificate = issuer


def _signed(certificate: x509.Certificate, issuer: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(issuer)
    except (InvalidSignature, ValueError, TypeError):
        return False
    return True


def unsigned(files: KeyFiles) -> str:
    """Return that no authority of this machine signed its certificate, "" if one did; raises `CertificateError`."""
    if signer(files.certificate, files.ca) is not None:
        return ""
    return f"{files.certificate} was not signed by {files.ca}; copy both from the same folder of 'midspan keys'"


def trouble(files: KeyFiles) -> str:
    """Return why no machine accepts this certificate now, "" if no reason is known."""
    try:
        files.check()
        certificate, strange = read_certificate(files.certificate), unsigned(files)
    except (HubConfigError, CertificateError) as err:
        return str(err)
    if (outdated := certificate.outdated()) and not certificate.begins_later():
        return f"{outdated}; {certificate.renewal}"
    return strange


def early(files: KeyFiles) -> str:
    """Return why no machine accepts this certificate yet, "" if it has begun or cannot be read.

    This is no reason to stay closed: the clock of a machine that has just started may be wrong.
    """
    try:
        certificate = read_certificate(files.certificate)
    except CertificateError:
        return ""
    if not certificate.begins_later():
        return ""
    return f"{certificate.outdated()}; set this machine's clock, or if it is right: {certificate.renewal}"


def _load(file: Path) -> list[x509.Certificate]:
    """Return the certificates in a file, at least one."""
    try:
        return x509.load_pem_x509_certificates(file.read_bytes())
    except OSError as err:
        msg = f"{file}: {err.strerror}"
    except ValueError:
        msg = f"{file} is not a certificate (PEM)"
    raise CertificateError(msg)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, days: int, latest: datetime | None = None
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    end = now + timedelta(days=days)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLIER)
        .not_valid_after(end if latest is None else min(end, latest))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )


def _x509_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _common_name(name: x509.Name) -> str:
    attributes = name.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(attributes[0].value) if attributes else ""


def general_names(name: str, names: Sequence[str] = ()) -> list[x509.GeneralName]:
    """Return the host names and addresses for a machine's certificate; raises `CertificateError` if one is invalid."""
    if not _NAME.fullmatch(name) or name == AUTHORITY:
        raise CertificateError(
            f"{name!r} is not a machine's name: letters, digits, '_', '.' and '-', not {AUTHORITY!r}"
        )
    if reason := forbidden(f"{name}.pem"):
        raise CertificateError(f"{name!r}: its certificate's {name}.pem {reason}")
    return [_general_name(text) for text in dict.fromkeys([name, f"{name}.local", *names])]


def _general_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        pass
    if not _HOST.fullmatch(name) or re.fullmatch(r"[0-9]+(\.[0-9]+){2,}", name):
        raise CertificateError(f"{name!r} is neither a host name nor an IP address")
    return x509.DNSName(name)


def write_private(file: Path, content: bytes) -> None:
    """Write a file that only its owner can read, either completely or not at all."""
    new = file.with_name(file.name + ".new")
    new.unlink(missing_ok=True)
    binary = getattr(os, "O_BINARY", 0)  # without it, Windows writes each line feed as two bytes
    handle = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL | binary, 0o600)
    with os.fdopen(handle, "wb") as out:
        out.write(content)
    new.replace(file)
