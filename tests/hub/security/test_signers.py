"""Which authority signed a certificate: several in one file, and intermediate ones."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from bridge.hub.security.certificates import Authority, CertificateError, read_certificate, signer, trouble
from bridge.hub.security.key_files import KeyFiles


def made(folder: Path) -> KeyFiles:
    authority = Authority(folder)
    authority.make()
    authority.issue("robot")
    return KeyFiles(folder / "ca.pem", folder / "robot.pem", folder / "robot.key")


class Issuer:
    """An authority of somebody else's own, which may have signed another one."""

    def __init__(self, name: str, parent: Issuer | None = None, *, signs: bool = True) -> None:
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        now, by = datetime.now(UTC), parent or self
        self.certificate = (
            x509.CertificateBuilder(by._name, self._name, self._key.public_key(), x509.random_serial_number())
            .not_valid_before(now - timedelta(days=1))
            .not_valid_after(now + timedelta(days=9))
            .add_extension(x509.BasicConstraints(ca=signs, path_length=None), critical=True)
            .sign(by._key, hashes.SHA256())
        )
        self.pem = self.certificate.public_bytes(serialization.Encoding.PEM)
        self.key = self._key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )


@pytest.mark.parametrize("first", [True, False])
def test_one_of_several_authorities_signed_it(tmp_path: Path, first: bool) -> None:
    files, other = made(tmp_path / "here"), made(tmp_path / "there")
    both = [files.ca.read_bytes(), other.ca.read_bytes()]
    files.ca.write_bytes(b"".join(both if first else reversed(both)))
    assert trouble(files) == files.trouble() == ""
    authority = signer(files.certificate, files.ca)
    assert authority is not None
    assert (authority.name, authority.file) == ("midspan authority", files.ca)
    files.ca.write_bytes(both[1])
    assert signer(files.certificate, files.ca) is None
    assert "was not signed by" in trouble(files)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_intermediate_authorities_in_the_certificates_file(tmp_path: Path, order: tuple[int, int]) -> None:
    root = Issuer("root")
    first = Issuer("first", root)
    second = Issuer("second", first)
    leaf = Issuer("robot", second, signs=False)
    files = KeyFiles(tmp_path / "ca.pem", tmp_path / "robot.pem", tmp_path / "robot.key")
    files.ca.write_bytes(root.pem)
    files.key.write_bytes(leaf.key)
    between = (first.pem, second.pem)
    files.certificate.write_bytes(leaf.pem + b"".join(between[index] for index in order))
    assert trouble(files) == files.trouble() == ""
    assert read_certificate(files.certificate).name == "robot"
    authority = signer(files.certificate, files.ca)
    assert authority is not None
    assert authority.name == "root"
    files.certificate.write_bytes(leaf.pem + second.pem)  # the first is missing
    assert signer(files.certificate, files.ca) is None


def test_a_machine_is_no_intermediate_authority(tmp_path: Path) -> None:
    root = Issuer("root")
    machine = Issuer("other", root, signs=False)
    files = KeyFiles(tmp_path / "ca.pem", tmp_path / "robot.pem", tmp_path / "robot.key")
    files.ca.write_bytes(root.pem)
    files.certificate.write_bytes(Issuer("robot", machine, signs=False).pem + machine.pem)
    assert signer(files.certificate, files.ca) is None, "TLS refuses it"


def test_a_file_without_certificates_is_named(tmp_path: Path) -> None:
    files = made(tmp_path)
    files.ca.write_bytes(b"-----BEGIN NOTHING-----\n")
    with pytest.raises(CertificateError, match=r"ca\.pem is not a certificate \(PEM\)"):
        signer(files.certificate, files.ca)
