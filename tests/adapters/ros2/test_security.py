"""SROS 2: the enclave of the side, and why it cannot join a secured domain."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from bridge.adapters.ros2 import environment, security
from bridge.adapters.ros2.environment import available, worker_environment
from bridge.adapters.ros2.graph.marks import PresenceMarks
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES, stored_prefixes
from bridge.config.model import Config
from bridge.hub.graph.tokens import Origin
from bridge.messages.registry import Registry
from bridge.routing.edge import Kind, MadeBy
from tests.adapters.ros2.conftest import RunningEdge
from tests.peers.peer import Peer
from tests.peers.ros2.network import ros2_environment
from tests.support.missing import ROS2, needs
from tests.support.wait import until

ON = {"ROS_SECURITY_ENABLE": "true"}


@pytest.mark.parametrize(
    ("environ", "enclave"),
    [
        ({}, None),
        ({"ROS_SECURITY_ENABLE": "false"}, None),
        (ON, "/midspan"),
        (ON | {"ROS_SECURITY_ENCLAVE_OVERRIDE": "/robot/bridge"}, "/robot/bridge"),
    ],
)
def test_the_worker_gets_an_enclave_if_security_is_on(environ: dict[str, str], enclave: str | None) -> None:
    assert worker_environment(Config(), environ).get("ROS_SECURITY_ENCLAVE_OVERRIDE") == enclave


def test_wheels_cannot_join_a_secured_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setattr(environment, "uses_wheels", lambda _environ: True)
    reason = available(Config())
    assert "the Fast DDS of the wheels is built without DDS Security; source an installed ROS 2" in reason


@needs(ROS2)
def test_fast_dds_of_the_wheels_has_no_security(tmp_path: Path) -> None:
    """If this fails, the wheels have DDS Security, and the side can join a secured domain."""
    (tmp_path / "enclaves").mkdir()
    program = "import rclpy; rclpy.init(); rclpy.create_node('secured')"
    env = ros2_environment(**ON, ROS_SECURITY_KEYSTORE=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=False)
    assert done.returncode
    assert "This Fast DDS version doesn't have the security libraries" in done.stderr


def test_an_installed_release_needs_the_enclave(tmp_path: Path) -> None:
    assert "ROS_SECURITY_KEYSTORE is not set" in security.trouble(ON, 7, wheels=False)
    environ = ON | {"ROS_SECURITY_KEYSTORE": str(tmp_path)}
    cure = f"'ROS_DOMAIN_ID=7 ros2 security create_enclave {tmp_path} /midspan'"
    assert security.trouble(environ, 7, wheels=False).endswith(cure)
    assert security.trouble({}, 7, wheels=True) == ""


def test_the_name_of_an_enclave_begins_with_a_slash(tmp_path: Path) -> None:
    """Rcl removes the first character, so it would search for the enclave 'idspan'."""
    (tmp_path / "enclaves/midspan").mkdir(parents=True)
    environ = ON | {"ROS_SECURITY_KEYSTORE": str(tmp_path), "ROS_SECURITY_ENCLAVE_OVERRIDE": "midspan"}
    assert security.trouble(environ, 0, wheels=False).endswith("set it to /midspan")


def test_a_keystore_that_cannot_be_read_is_reported() -> None:
    """As another user than root: permission denied; the name of this one is too long for any user."""
    environ = ON | {"ROS_SECURITY_KEYSTORE": "/" + "k" * 300}
    reason = security.trouble(environ, 0, wheels=False)
    assert "File name too long; the user of Midspan's daemon needs read access" in reason


DOMAIN = """MIME-Version: 1.0\n\n<?xml version="1.0"?>
<dds><domain_access_rules><domain_rule><domains>{domains}</domains></domain_rule></domain_access_rules></dds>\n---"""
GRANT = """MIME-Version: 1.0\n\n<?xml version="1.0"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"><permissions><grant name="/midspan">
<subject_name>CN={subject}</subject_name>
<validity><not_before>{since}</not_before><not_after>{until}</not_after></validity>
<allow_rule><domains>{domains}</domains></allow_rule></grant></permissions></dds>\n---"""


class Keystore:
    """A keystore with the enclave /midspan, as 'ros2 security' makes it; its documents are not signed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.enclave = folder / "enclaves/midspan"
        self.enclave.mkdir(parents=True)
        self.authority = ec.generate_private_key(ec.SECP256R1())
        self.certificate("identity_ca.cert", days=10)
        self.certificate("permissions_ca.cert", days=10)
        self.certificate("cert", days=10)
        self.rules()

    def certificate(self, name: str, days: int, subject: str = "/midspan") -> None:
        """Write a certificate; the file of the enclave's own, and its key, replace earlier ones."""
        is_own, now = name == "cert", datetime.now(UTC)
        key = ec.generate_private_key(ec.SECP256R1()) if is_own else self.authority
        names = [
            x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
            for name in (subject if is_own else "sros2CA", "sros2CA")
        ]
        builder = x509.CertificateBuilder(names[1], names[0], key.public_key(), x509.random_serial_number())
        builder = builder.not_valid_before(now + timedelta(days=-30)).not_valid_after(now + timedelta(days=days))
        signed = builder.sign(self.authority, hashes.SHA256())
        (self.enclave / f"{name}.pem").write_bytes(signed.public_bytes(serialization.Encoding.PEM))
        if is_own:
            self.key(key)

    def key(self, key: ec.EllipticCurvePrivateKey) -> None:
        pem = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        (self.enclave / "key.pem").write_bytes(key.private_bytes(*pem))

    def rules(
        self, governance: str = "<id>0</id>", permissions: str = "<id>0</id>", until: str = "2100-01-01",
        since: str = "2020-01-01", subject: str = "/midspan",
    ) -> None:  # fmt: skip
        times = {"since": f"{since}T00:00:00", "until": f"{until}T00:00:00"}
        (self.enclave / "governance.p7s").write_text(DOMAIN.format(domains=governance))
        grant = GRANT.format(domains=permissions, subject=subject, **times)
        (self.enclave / "permissions.p7s").write_text(grant)

    def trouble(self, domain: int = 0) -> str:
        return security.trouble(ON | {"ROS_SECURITY_KEYSTORE": str(self.folder)}, domain, wheels=False)


@pytest.fixture
def keystore(tmp_path: Path) -> Keystore:
    return Keystore(tmp_path)


def test_a_complete_enclave_has_no_trouble(keystore: Keystore) -> None:
    assert keystore.trouble() == ""
    keystore.rules("<id_range><min>0</min><max>9</max></id_range>", "<id>3</id><id>7</id>")
    assert keystore.trouble(7) == ""
    keystore.rules("<id_range><min>0</min></id_range>")  # without an end
    assert keystore.trouble() == ""


@pytest.mark.parametrize(
    "name", ["cert.pem", "key.pem", "permissions_ca.cert.pem", "governance.p7s", "permissions.p7s"]
)
def test_a_missing_file_is_named(keystore: Keystore, name: str) -> None:
    (keystore.enclave / name).unlink()
    assert keystore.trouble().startswith(f"{keystore.enclave / name} is missing; 'ROS_DOMAIN_ID=0 ros2 security create")


def test_an_expired_certificate_is_reported(keystore: Keystore) -> None:
    keystore.certificate("cert", days=-3)
    assert f"the certificate {keystore.enclave / 'cert.pem'} has expired on 20" in keystore.trouble()
    assert "; remove it, then 'ROS_DOMAIN_ID=0 ros2 security create_enclave" in keystore.trouble()
    keystore.certificate("cert", days=3)
    keystore.certificate("identity_ca.cert", days=-3)
    assert "; create a new keystore with new enclaves" in keystore.trouble()


def test_expired_permissions_are_reported(keystore: Keystore) -> None:
    keystore.rules(until="2021-05-06")
    assert "permissions.p7s have expired on 2021-05-06" in keystore.trouble()


def test_permissions_that_are_not_valid_yet_are_reported(keystore: Keystore) -> None:
    keystore.rules(since="2099-05-06")
    assert "permissions.p7s are valid only from 2099-05-06: is this machine's clock right" in keystore.trouble()


def test_grants_of_other_enclaves_are_ignored(keystore: Keystore) -> None:
    file = keystore.enclave / "permissions.p7s"
    own = file.read_text()
    keystore.rules(until="2021-05-06", permissions="<id>9</id>", subject="/camera")
    other = file.read_text()
    both = own.replace("<grant", other[other.index("<grant") : other.index("</permissions>")] + "<grant", 1)
    file.write_text(both)
    assert keystore.trouble() == ""


def test_files_of_different_enclaves_are_reported(keystore: Keystore) -> None:
    """Fast DDS would only log "Participant is not allowed with its own permissions file"."""
    folder = keystore.enclave
    again = f"; remove the folder, then 'ROS_DOMAIN_ID=0 ros2 security create_enclave {keystore.folder} /midspan'"
    keystore.rules(subject="/camera")
    reason = f"has no grant for CN=/midspan, the subject of {folder / 'cert.pem'}"
    assert keystore.trouble() == f"{folder / 'permissions.p7s'} {reason}{again}"
    keystore.certificate("cert", days=3, subject="/camera")
    assert keystore.trouble() == ""
    keystore.key(keystore.authority)
    assert keystore.trouble() == f"{folder / 'key.pem'} is not the private key of {folder / 'cert.pem'}{again}"
    keystore.certificate("cert", days=3, subject="/camera")
    keystore.authority = ec.generate_private_key(ec.SECP256R1())
    keystore.certificate("identity_ca.cert", days=10)
    issued = f"the authority in {folder / 'identity_ca.cert.pem'} did not issue {folder / 'cert.pem'}"
    assert keystore.trouble() == f"{issued}{again}"


def test_an_authority_may_be_one_of_several(keystore: Keystore) -> None:
    file, others = keystore.enclave / "identity_ca.cert.pem", keystore.enclave / "permissions_ca.cert.pem"
    own = file.read_bytes()
    keystore.authority = ec.generate_private_key(ec.SECP256R1())
    keystore.certificate("permissions_ca.cert", days=10)
    file.write_bytes(others.read_bytes() + own)
    assert keystore.trouble() == ""


def test_an_invalid_private_key_is_reported(keystore: Keystore) -> None:
    (keystore.enclave / "key.pem").write_text("private")
    reason = keystore.trouble()
    assert reason.startswith(f"{keystore.enclave / 'key.pem'} is not a private key in PEM format without a password")
    assert "; remove it, then 'ROS_DOMAIN_ID=0 ros2 security create_enclave" in reason


def test_a_rejection_that_is_only_logged_names_the_cure(keystore: Keystore) -> None:
    reason = security.rejection(ON | {"ROS_SECURITY_KEYSTORE": str(keystore.folder)}, 7)
    assert f"it rejects the files in {keystore.enclave}; the log names the reason" in reason
    assert reason.endswith(f"then 'ROS_DOMAIN_ID=7 ros2 security create_enclave {keystore.folder} /midspan'")


@pytest.mark.parametrize("file", ["governance", "permissions"])
def test_an_enclave_for_another_domain_is_reported(keystore: Keystore, file: str) -> None:
    """'ros2 security' makes the files for the domain in ROS_DOMAIN_ID, which is 0 if the variable is not set."""
    keystore.rules(**({"governance": "<id>7</id>", "permissions": "<id>7</id>"} | {file: "<id>0</id>"}))
    assert f"{file}.p7s is for domain 0, but Midspan's is 7" in keystore.trouble(7)
    again = {"governance": "create_keystore", "permissions": "create_enclave"}[file]
    assert f"'ROS_DOMAIN_ID=7 ros2 security {again} {keystore.folder}" in keystore.trouble(7)


def test_an_invalid_document_is_reported(keystore: Keystore) -> None:
    (keystore.enclave / "permissions.p7s").write_text("MIME-Version: 1.0")
    assert "permissions.p7s is not a signed document of DDS Security" in keystore.trouble()
    (keystore.enclave / "cert.pem").write_text("no certificate")
    assert "cert.pem is not a certificate in PEM format" in keystore.trouble()


def test_a_refused_endpoint_names_the_permissions() -> None:
    assert security.refusal({}) == ""
    assert "the permissions of the enclave /midspan" in security.refusal(ON)


# -- the GUID prefix of a secured domain -------------------------------------------------------------------------------
# DDS Security replaces the prefix, so it has no mark. The wheels' Fast DDS cannot show that, but the marks are tested
# with participants that never had one.

SECURED, OTHER_SECURED = (bytes([0x80 | first]) + bytes(range(15)) for first in (1, 2))


def test_in_a_secured_domain_the_presence_topic_marks_a_midspan() -> None:
    announced: list[bytes] = []
    marks = PresenceMarks(lambda: announced)
    assert marks.made_by(OTHER_SECURED) is MadeBy.NATIVE
    announced += [SECURED[:PREFIX_BYTES] + b"\0\0\1\3"]
    assert marks.of_endpoint(SECURED, "/midspan", has_hash=True) is MadeBy.MIDSPAN
    assert marks.made_by(SECURED[:PREFIX_BYTES]) is MadeBy.MIDSPAN
    announced += [OTHER_SECURED]
    marks.refresh()
    assert marks.made_by(OTHER_SECURED) is MadeBy.MIDSPAN
    announced.clear()
    assert marks.made_by(SECURED) is MadeBy.MIDSPAN  # also while its last messages arrive


@pytest.fixture
def secured(monkeypatch: pytest.MonkeyPatch, registry: Registry, tmp_path: Path) -> Iterator[RunningEdge]:
    """An edge that believes to be in a secured domain."""
    monkeypatch.setattr(security, "is_enabled", lambda _environ: True)
    running = RunningEdge(registry, tmp_path)
    yield running
    running.edge.stop()


@needs(ROS2)
def test_another_midspan_without_a_marked_prefix_is_not_bridged(
    secured: RunningEdge, peer: Callable[..., Peer]
) -> None:
    inbox = secured.subscribe("/secured", "std_msgs/msg/String")
    other, native = peer("midspan"), peer("camera")
    other.advertise("/_midspan/presence", "std_msgs/String", latched=True)
    other_publisher = other.advertise("/secured", "std_msgs/String")
    native_publisher = native.advertise("/secured", "std_msgs/String")
    ends = secured.until_seen("/secured", Kind.PUBLISHER, 2)
    assert {end.node: end.made_by for end in ends} == {"/midspan": MadeBy.MIDSPAN, "/camera": MadeBy.NATIVE}
    (midspan,) = (bytes.fromhex(end.id)[:PREFIX_BYTES] for end in ends if end.made_by is MadeBy.MIDSPAN)
    assert secured.edge.is_own_network(Origin("ros2", midspan.hex(), "other"))

    def arrives() -> bool:
        other.publish(other_publisher, {"data": "loop"})
        native.publish(native_publisher, {"data": "native"})
        return "native" in inbox.texts()

    until(arrives, "the message of the native publisher arrives", every=0.1)
    assert "loop" not in inbox.texts()


@needs(ROS2)
def test_the_prefix_in_use_is_the_one_that_dds_reports(secured: RunningEdge, tmp_path: Path) -> None:
    """Other daemons compare it with the participants that they discover."""
    context = secured.edge._context
    assert context is not None
    own = {gid[:PREFIX_BYTES] for gid in context.participant.participants()}
    assert own == {bytes.fromhex(secured.edge.network() or "")}
    assert stored_prefixes(tmp_path / "ros2")[-1:] == list(own)
