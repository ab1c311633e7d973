"""Test connections to an endpoint of ``hub.open``: TCP, then TLS with this machine's certificate.

zenoh reports its links, but not why a link fails, so this module tests the endpoint. It completes the handshake and
closes the connection in an orderly way, so that zenoh's listener logs nothing above the debug level. In TLS 1.3 a
listener refuses a client's certificate only after the client considers the handshake complete (RFC 8446, 4.4.2.4 and
6.2), so the test reads once before it closes. Each step has a short time limit, because zenoh accepts only one
handshake at a time.
"""

from __future__ import annotations

import contextlib
import json
import re
import socket
import ssl
from dataclasses import dataclass, field
from pathlib import Path

import zenoh
from typing_extensions import override

from bridge.hub.security.key_files import tls_trouble
from bridge.hub.security.reasons import EndpointState, Reason, refused_by_other, refused_certificate, unreachable

_CONNECT_SECONDS = 3.0
_HANDSHAKE_SECONDS = 3.0
_ALERT_SECONDS = 0.7
"""Seconds for the other machine's alert to arrive; zenoh's listener waits for the first message meanwhile."""

_MOST_ADDRESSES = 4
"""Maximum number of addresses of one host name that are tried."""

_SAYS_NOTHING = "the program there accepts connections, but opens no zenoh session"


@dataclass(frozen=True, slots=True)
class Identity:
    """The files for TLS: the authority's certificate, and with mutual TLS this machine's certificate and key."""

    ca: Path
    certificate: Path | None
    key: Path | None
    verify_name: bool = True

    @classmethod
    def of(cls, config: zenoh.Config) -> Identity | None:
        """Return the identity from zenoh's final configuration; None if it has no files for TLS."""
        tls = json.loads(config.get_json("transport/link/tls"))
        ca, certificate, key = (
            tls.get(name) for name in ("root_ca_certificate", "connect_certificate", "connect_private_key")
        )
        if not ca:
            return None
        mutual = bool(tls.get("enable_mtls")) and certificate and key
        return cls(
            Path(ca),
            Path(certificate) if mutual else None,
            Path(key) if mutual else None,
            tls.get("verify_name_on_connect") is not False,
        )

    def context(self) -> ssl.SSLContext:
        """Create a context that verifies the other machine; raises `OSError` for files that cannot be used."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = self.verify_name
        context.load_verify_locations(self.ca)
        if self.certificate is not None:
            context.load_cert_chain(self.certificate, self.key, password="")
        return context


@dataclass(frozen=True, slots=True)
class Attempt:
    """The result of one test connection.

    Attributes:
        reason: the state with its reason; the state is ``connecting`` if all steps that were tested succeeded.
        machine: the name in the other machine's certificate, "" if it is unknown.
        addresses: addresses of the endpoint in zenoh's format (``tls/192.168.1.20:7448``).
    """

    reason: Reason
    machine: str = ""
    addresses: frozenset[str] = field(default_factory=frozenset)


@dataclass(frozen=True, slots=True)
class HostPort:
    """A zenoh endpoint's protocol, host and port."""

    protocol: str
    host: str
    port: int

    @override
    def __str__(self) -> str:
        """Return ``host:port``, with IPv6 addresses in brackets."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @classmethod
    def of(cls, endpoint: str) -> HostPort | None:
        """Return the parts of an endpoint; None if it is not of the form ``protocol/host:port``."""
        protocol, _, address = endpoint.partition("/")
        host, _, port = re.split(r"[?#]", address)[0].rpartition(":")
        if not host or not port.isdecimal() or len(port) > 5 or int(port) > 65535:
            return None
        return cls(protocol, host.strip("[]"), int(port))

    @property
    def can_be_tested(self) -> bool:
        """Whether `attempt` can connect to it: not over QUIC, which this module does not support, nor over UDP."""
        return self.protocol in ("tls", "tcp")


def resolve(place: HostPort) -> list[HostPort]:
    """Return a copy of the place for each of its first 4 addresses; raises `OSError` if its name cannot be resolved."""
    try:
        results = socket.getaddrinfo(place.host, place.port, type=socket.SOCK_STREAM)
    except UnicodeError as err:
        raise OSError(f"{place.host!r} is not a host name: {err}") from None
    addresses = dict.fromkeys(str(address[0]) for *_, address in results)
    return [HostPort(place.protocol, address, place.port) for address in addresses][:_MOST_ADDRESSES]


def resolve_only(place: HostPort) -> Attempt:
    """Return only the addresses of a place, without connecting to it."""
    try:
        places = resolve(place)
    except OSError as err:
        return Attempt(unreachable(err, str(place)))
    reason = Reason(EndpointState.CONNECTING, f"no link, and zenoh does not report why over {place.protocol}")
    return Attempt(reason, "", frozenset(f"{place.protocol}/{address}" for address in places))


def attempt(place: HostPort, identity: Identity | None, name: str = "") -> Attempt:
    """Connect to the first reachable address of a place, and close the connection again.

    Once the name is resolved, this takes at most about 14 s, plus 3 s for each address that does not respond.
    ``name`` is the name to verify in the other machine's certificate, by default the place's host.
    """
    try:
        places = resolve(place)
    except OSError as err:
        return Attempt(unreachable(err, str(place)))
    addresses = frozenset(f"{place.protocol}/{address}" for address in places)
    reason, machine = Reason(EndpointState.UNREACHABLE, f"the name {place.host} has no address"), ""
    for address in places:
        try:
            if place.protocol == "tcp" or identity is None:
                _connect(address).close()
                reason = Reason(EndpointState.CONNECTING, _SAYS_NOTHING)
            else:
                reason, machine = _handshake(address, identity, name or place.host)
        except OSError as err:
            reason = unreachable(err, str(place))
            continue
        break
    return Attempt(reason, machine, addresses)


def refusal(endpoint: str, config: zenoh.Config) -> Reason | None:
    """Return why one end of a TLS connection to an endpoint refuses the other end's certificate; None if neither does.

    It also returns a reason if this machine's files cannot be used, or the other end closes the connection during the
    handshake. ``config`` is the session's configuration. Only the protocol ``tls`` is tested. The test takes as long as
    `attempt`.
    """
    place, identity = HostPort.of(endpoint), Identity.of(config)
    if place is None or place.protocol != "tls" or identity is None:
        return None
    reason = attempt(place, identity).reason
    return reason if reason.state is EndpointState.REFUSED else None


def _connect(place: HostPort) -> socket.socket:
    return socket.create_connection((place.host, place.port), timeout=_CONNECT_SECONDS)


def _handshake(place: HostPort, identity: Identity, name: str) -> tuple[Reason, str]:
    """Return the reason and the other machine's name; raises `OSError` if not even TCP connects."""
    try:
        context = identity.context()
    except OSError as err:  # this includes ssl.SSLError
        files = tls_trouble(identity.ca, identity.certificate, identity.key)
        text = f"this machine's certificate files cannot be used: {files or err}"
        return Reason(EndpointState.REFUSED, text, "'midspan doctor --only keys' names the file"), ""
    with _connect(place) as plain:
        plain.settimeout(_HANDSHAKE_SECONDS)
        try:
            tls = context.wrap_socket(plain, server_hostname=name)
        except ssl.SSLCertVerificationError as err:
            refusal = f"{err.verify_message} ({err.verify_code})"
        except OSError as err:
            return _broken(err, place), ""
        else:
            with tls:
                subject = tls.getpeercert() or {}
                return _after_handshake(tls, place), _common_name(subject)
    return _details(place, identity, name, refusal)


def _after_handshake(tls: ssl.SSLSocket, place: HostPort) -> Reason:
    """Read once, to receive the alert of a listener that does not accept this machine's certificate."""
    tls.settimeout(_ALERT_SECONDS)
    try:
        tls.recv(1)
    except TimeoutError:
        pass  # the listener waits for the first message: it accepted the certificate
    except OSError as err:
        return _broken(err, place)
    with contextlib.suppress(OSError):
        tls.unwrap()  # close_notify, so that the other end sees an orderly close
    return Reason(EndpointState.CONNECTING, _SAYS_NOTHING)


def _broken(err: OSError, place: HostPort) -> Reason:
    """Return the reason why the other end broke off a handshake."""
    if isinstance(err, ssl.SSLError) and "ALERT" in (err.reason or ""):
        return refused_by_other(str(err.reason))
    if isinstance(err, TimeoutError):
        text = f"{place} accepts the connection, but does not answer TLS within {_HANDSHAKE_SECONDS:g} s"
        return Reason(EndpointState.NOT_ANSWERING, text, "compare the port with hub.open.listen there")
    if isinstance(err, ssl.SSLError) and err.reason in ("WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE"):
        text = f"the program at {place} does not answer with TLS"
        return Reason(EndpointState.NOT_ANSWERING, text, "compare the port with hub.open.listen there")
    text = f"{place} closes the connection during the TLS handshake ({err})"
    return Reason(
        EndpointState.REFUSED, text, "see the log of the router there: it may refuse this machine's certificate"
    )


def _details(place: HostPort, identity: Identity, name: str, refusal: str) -> tuple[Reason, str]:
    """Request the refused certificate again without verifying it, to report its names and dates.

    Nothing is sent over this connection after the handshake. The connection also shows whether the other machine
    refuses this machine's certificate.
    """
    context = identity.context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        with _connect(place) as plain:
            plain.settimeout(_HANDSHAKE_SECONDS)
            with context.wrap_socket(plain, server_hostname=name) as tls:
                certificate = tls.getpeercert(binary_form=True) or b""
                theirs = _after_handshake(tls, place)
    except OSError:
        return refused_certificate(refusal), ""
    detail, machine = _explain_refusal(certificate, refusal)
    reason = refused_certificate(refusal, detail)
    if theirs.state is EndpointState.REFUSED:
        return Reason(reason.state, f"{reason.text}; {theirs.text}", reason.cure), machine
    return reason, machine


def _explain_refusal(certificate: bytes, refusal: str) -> tuple[str, str]:
    """Return the detail of a certificate that explains its refusal, and its common name."""
    from cryptography import x509

    try:
        content = x509.load_der_x509_certificate(certificate)
        names = [str(name.value) for name in content.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)]
        try:
            alternatives = content.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except x509.ExtensionNotFound:
            alternatives = x509.SubjectAlternativeName([])
        hosts = ", ".join(str(alternative.value) for alternative in alternatives)
    except ValueError:
        return "", ""
    machine = names[0] if names else ""
    if "mismatch" in refusal:
        return f", but for {hosts or 'none'}", machine
    if "expired" in refusal:
        return f" on {content.not_valid_after_utc:%Y-%m-%d}", machine
    if "not yet valid" in refusal:
        return f", but from {content.not_valid_before_utc:%Y-%m-%d}", machine
    return f" (it names the machine {machine!r})" if machine else "", machine


def _common_name(certificate: object) -> str:
    subject = certificate.get("subject", ()) if isinstance(certificate, dict) else ()
    return next((str(value) for part in subject for key, value in part if key == "commonName"), "")
