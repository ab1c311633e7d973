"""The connections that test the endpoints of `hub.open`, against real zenoh listeners with TLS."""

from __future__ import annotations

import errno
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from pathlib import Path

import pytest
import zenoh

from bridge.client.errors import UnreachableHubError
from bridge.client.session import connect
from bridge.config.model import Config
from bridge.hub.security import certificates
from bridge.hub.security.certificates import Authority
from bridge.hub.security.handshake import Attempt, HostPort, Identity, attempt
from bridge.hub.security.reasons import EndpointState, refusal_in_log, unreachable
from bridge.hub.zenoh_config import make_config, router_tree
from tests.support.ports import free_port
from tests.support.wait import until
from tests.support.zenoh_router import open_router


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two fleets, each with an authority and its machines, in the folders ``a`` and ``b``."""
    folder = tmp_path_factory.mktemp("keys")
    for fleet in ("a", "b"):
        authority = Authority(folder / fleet)
        authority.make()
        authority.issue("robot1", ["127.0.0.1", "::1"])
        authority.issue("operator1", ["127.0.0.1"])
        authority.issue("expired", ["127.0.0.1"], days=-1)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(certificates, "_EARLIER", timedelta(hours=-6))  # made on a machine whose clock was ahead
            authority.issue("early", ["127.0.0.1"])
        authority.issue("nowhere")
    return folder


@contextmanager
def listener(folder: Path, name: str, endpoint: str) -> Iterator[zenoh.Session]:
    """A zenoh router that asks for certificates, as another machine's external router does."""
    tls = {
        "root_ca_certificate": str(folder / "ca.pem"),
        "listen_certificate": str(folder / f"{name}.pem"),
        "listen_private_key": str(folder / f"{name}.key"),
        "enable_mtls": True,
    }
    tree = router_tree([endpoint], max_payload=1 << 20)
    with open_router(make_config(tree, {"transport": {"link": {"tls": tls}}})) as session:
        yield session


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let listeners answer late, as on a busy machine."""
    for limit in ("_CONNECT_SECONDS", "_HANDSHAKE_SECONDS"):
        monkeypatch.setattr(f"bridge.hub.security.handshake.{limit}", 40.0)


@pytest.fixture
def late_alert(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the alert of a listener that refuses this machine's certificate be late; without one, a test would wait."""
    monkeypatch.setattr("bridge.hub.security.handshake._ALERT_SECONDS", 40.0)


def identity(folder: Path, name: str) -> Identity:
    return Identity(folder / "ca.pem", folder / f"{name}.pem", folder / f"{name}.key")


def attempted(endpoint: str, own: Identity | None) -> Attempt:
    place = HostPort.of(endpoint)
    assert place is not None
    return attempt(place, own)


@pytest.mark.parametrize(
    ("theirs", "ours", "host", "texts"),
    [
        ("a/robot1", "a/operator1", "127.0.0.1", ()),
        ("a/robot1", "b/operator1", "127.0.0.1", ("other machine's certificate is from another authority", "'robot1'",
                                                  "does not accept this machine's certificate")),
        ("a/expired", "a/operator1", "127.0.0.1", ("other machine's certificate has expired on ",)),
        ("a/nowhere", "a/operator1", "127.0.0.1", ("is not for the name or address", "nowhere.local")),
        ("a/robot1", "a/operator1", "localhost", ("is not for the name or address", "robot1.local, 127.0.0.1")),
        ("a/robot1", "a/expired", "127.0.0.1", ("does not accept this machine's certificate: it has expired",)),
        ("a/early", "a/operator1", "127.0.0.1", ("the other machine's certificate is not valid yet, but from ",)),
        ("a/robot1", "a/early", "127.0.0.1", ("does not accept this machine's certificate: ", "is not valid yet")),
    ],
)  # fmt: skip
def test_a_refused_certificate_is_reported_with_its_cure(
    keys: Path, theirs: str, ours: str, host: str, texts: tuple[str, ...], request: pytest.FixtureRequest
) -> None:
    if any("does not accept this machine" in text for text in texts):
        request.getfixturevalue("late_alert")
    port = free_port()
    folder, name = theirs.split("/")
    with listener(keys / folder, name, f"tls/127.0.0.1:{port}"):
        fleet, machine_name = ours.split("/")
        result = attempted(f"tls/{host}:{port}", identity(keys / fleet, machine_name))
    assert result.reason.state == (EndpointState.REFUSED if texts else EndpointState.CONNECTING)
    for text in texts:
        assert text in result.reason.text
    assert bool(result.reason.cure) is bool(texts)
    assert f"tls/127.0.0.1:{port}" in result.addresses
    assert texts or result.machine == "robot1"


@pytest.mark.usefixtures("late_alert")
@pytest.mark.parametrize("certificate", ["b/operator1", ""])
def test_a_listener_refuses_the_certificate_after_the_handshake(keys: Path, certificate: str) -> None:
    """In TLS 1.3, the client considers the handshake complete before the listener checks the client's certificate."""
    port = free_port()
    fleet, _, name = certificate.partition("/")
    other = identity(keys / fleet, name) if certificate else Identity(keys / "a" / "ca.pem", None, None)
    client_identity = Identity(keys / "a" / "ca.pem", other.certificate, other.key)
    with listener(keys / "a", "robot1", f"tls/127.0.0.1:{port}"):
        result = attempted(f"tls/127.0.0.1:{port}", client_identity)
    assert result.reason.state is EndpointState.REFUSED
    expected = "it is from another authority" if certificate else "asks for a certificate, and gets none"
    assert expected in result.reason.text


def test_a_handshake_succeeds_over_ipv6(keys: Path) -> None:
    port = free_port()
    with listener(keys / "a", "robot1", f"tls/[::1]:{port}"):
        result = attempted(f"tls/[::1]:{port}?rel=1#iface=lo", identity(keys / "a", "operator1"))
    assert result.reason.state is EndpointState.CONNECTING
    assert result.addresses == {f"tls/[::1]:{port}"}


def test_an_address_without_a_listener_is_reported(keys: Path) -> None:
    result = attempted(f"tls/127.0.0.1:{free_port()}", identity(keys / "a", "operator1"))
    assert result.reason.state is EndpointState.NOT_ANSWERING
    assert "nothing listens" in result.reason.text
    assert "hub.open.listen" in result.reason.cure


def test_an_unknown_host_is_unreachable(keys: Path) -> None:
    result = attempted("tls/robot9.invalid:7448", identity(keys / "a", "operator1"))
    assert result.reason.state is EndpointState.UNREACHABLE
    assert "robot9.invalid cannot be resolved" in result.reason.text


@pytest.mark.parametrize(
    ("error", "state", "text"),
    [
        (OSError(errno.ENETUNREACH, "Network is unreachable"), EndpointState.UNREACHABLE, "no route to 10.0.0.9"),
        (OSError(errno.EHOSTUNREACH, "No route to host"), EndpointState.UNREACHABLE, "no route to 10.0.0.9"),
        (TimeoutError("timed out"), EndpointState.NOT_ANSWERING, "no answer from 10.0.0.9:7448"),
        (OSError(errno.EACCES, "Permission denied"), EndpointState.UNREACHABLE, "Permission denied"),
    ],
)
def test_a_connection_error_gives_a_state_and_a_reason(error: OSError, state: EndpointState, text: str) -> None:
    reason = unreachable(error, "10.0.0.9:7448")
    assert reason.state is state
    assert text in reason.text


@pytest.mark.parametrize("host", ["a" * 70, "a..b"])
def test_an_invalid_host_name_is_unreachable(host: str) -> None:
    result = attempted(f"tcp/{host}:7447", None)
    assert result.reason.state is EndpointState.UNREACHABLE
    assert "is not a host name" in result.reason.text


def test_an_overlong_port_number_is_refused() -> None:
    assert HostPort.of("tcp/127.0.0.1:" + "1" * 5000) is None


def test_a_host_that_drops_packets_does_not_answer(keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Linux does not respond on a port whose queue is full, like a machine that is switched off."""
    monkeypatch.setattr("bridge.hub.security.handshake._CONNECT_SECONDS", 0.3)
    with ExitStack() as stack:
        full = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
        for _ in range(4):
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(full.getsockname())
        port = full.getsockname()[1]
        for endpoint in (f"tls/127.0.0.1:{port}", f"tcp/127.0.0.1:{port}"):
            result = attempted(endpoint, identity(keys / "a", "operator1"))
            assert result.reason.state is EndpointState.NOT_ANSWERING
            assert result.reason.text == f"no answer from 127.0.0.1:{port}"


@contextmanager
def server(answer: bytes | None) -> Iterator[str]:
    """Run a TCP server that replies to the first bytes, or stays silent."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(10.0)

        def serve() -> None:
            connection, _ = listening.accept()
            with connection:
                connection.recv(1000)
                if answer is not None:
                    connection.sendall(answer)
                    return
                while connection.recv(1000):
                    pass

        thread = threading.Thread(target=serve)
        thread.start()
        yield f"tls/127.0.0.1:{listening.getsockname()[1]}"
        thread.join(10.0)
        assert not thread.is_alive(), "the test connection is still open"


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (None, "does not answer TLS"),
        (b"SSH-2.0-OpenSSH_9.2\r\n", "does not answer with TLS"),
        (b"", "closes the connection during the TLS handshake"),
    ],
)
def test_a_program_that_is_not_zenoh_is_reported(
    keys: Path, answer: bytes | None, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if answer is None:  # an answer may take longer on a busy machine
        monkeypatch.setattr("bridge.hub.security.handshake._HANDSHAKE_SECONDS", 0.3)
    with server(answer) as endpoint:
        result = attempted(endpoint, identity(keys / "a", "operator1"))
    assert not result.reason.state.good
    assert text in result.reason.text


def test_connection_closes_in_order(keys: Path) -> None:
    """A listener for plain TCP gets a connection that is closed at once, and no connection stays open."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        result = attempted(f"tcp/127.0.0.1:{listening.getsockname()[1]}", None)
        connection, _ = listening.accept()
        with connection:
            connection.settimeout(5.0)
            assert connection.recv(1) == b""
    assert result.reason.state is EndpointState.CONNECTING


def test_unusable_certificate_files_are_reported(keys: Path, tmp_path: Path) -> None:
    broken = Identity(keys / "a" / "ca.pem", keys / "a" / "robot1.pem", keys / "a" / "operator1.key")
    port = free_port()
    with listener(keys / "a", "robot1", f"tls/127.0.0.1:{port}"):
        for client_identity in (broken, Identity(tmp_path / "ca.pem", None, None)):
            result = attempted(f"tls/127.0.0.1:{port}", client_identity)
            assert result.reason.state is EndpointState.REFUSED
            assert "this machine's certificate files cannot be used" in result.reason.text


@pytest.mark.parametrize("endpoint", ["tls/robot1", "unixsock-stream//tmp/x", "tls/robot1:http", "tls/:7448", "x"])
def test_endpoints_without_a_host_and_a_port_are_not_tested(endpoint: str) -> None:
    assert HostPort.of(endpoint) is None


@pytest.mark.parametrize(
    ("error", "text"),
    [
        ("received fatal alert: DecryptError", "this machine's certificate: it is from another authority"),
        ("received fatal alert: UnknownCA", "this machine's certificate: it is from another authority"),
        ("received fatal alert: BadCertificate", "does not accept this machine's certificate: it is not for the name"),
        ("received fatal alert: CertificateExpired", "does not accept this machine's certificate: it has expired"),
        ("invalid peer certificate: UnknownIssuer", "is refused: its certificate is from another authority"),
        ("invalid peer certificate: certificate expired: verification time 5 (UNIX)", "its certificate has expired"),
        ("invalid peer certificate: certificate not valid yet: verification time 1 (UNIX)", "is not valid yet"),
        ("peer sent no certificates", "connects without a certificate"),
        ("tls handshake eof", ""),
        ("Too many open files (os error 24)", ""),
    ],
)  # fmt: skip
def test_the_reason_of_a_refusal_is_read_from_zenohs_log(error: str, text: str) -> None:
    reason = refusal_in_log(error, "10.0.0.9")
    assert (reason is None) is (text == "")
    assert reason is None or (reason.text.startswith("a machine at 10.0.0.9 ") and text in reason.text and reason.cure)


def test_zenoh_itself_links_after_a_test(keys: Path) -> None:
    """A test connection does not block the listener, which accepts a real session right after it."""
    port = free_port()
    client_identity = identity(keys / "a", "operator1")
    tls = {
        "root_ca_certificate": str(client_identity.ca), "connect_certificate": str(client_identity.certificate),
        "connect_private_key": str(client_identity.key), "enable_mtls": True,
    }  # fmt: skip
    with listener(keys / "a", "robot1", f"tls/127.0.0.1:{port}") as robot:
        for _ in range(3):
            assert attempted(f"tls/127.0.0.1:{port}", client_identity).reason.state is EndpointState.CONNECTING
        assert not robot.info.links()
        tree = router_tree([], max_payload=1 << 20)
        tree["connect"]["endpoints"] = [f"tls/127.0.0.1:{port}"]
        with open_router(make_config(tree, {"transport": {"link": {"tls": tls}}})):
            until(
                lambda: [link.auth_identifier for link in robot.info.links()] == ["operator1"], "the link is up", 10.0
            )


@pytest.mark.usefixtures("late_alert")
def test_a_program_with_a_refused_certificate_does_not_wait_for_a_busy_router(keys: Path) -> None:
    port, folder, waits = free_port(), keys / "b", list[str]()
    tls = {
        "root_ca_certificate": str(folder / "ca.pem"),
        "connect_certificate": str(folder / "operator1.pem"),
        "connect_private_key": str(folder / "operator1.key"),
        "enable_mtls": True,
    }
    hub = {"listen": f"tls/127.0.0.1:{port}", "zenoh": {"transport": {"link": {"tls": tls}}}}
    with (
        listener(keys / "a", "robot1", f"tls/127.0.0.1:{port}"),
        pytest.raises(UnreachableHubError, match="does not accept this machine's certificate") as raised,
        connect(Config.model_validate({"hub": hub}), 0.5, on_wait=waits.append),
    ):
        pass
    assert "copy ca.pem and each machine's certificate" in raised.value.hint
    assert waits == []
