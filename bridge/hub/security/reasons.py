"""Explains errors of OpenSSL, rustls and the system when two machines do not connect, and how to fix them."""

from __future__ import annotations

import errno
import re
import socket
from dataclasses import dataclass
from enum import StrEnum


class EndpointState(StrEnum):
    """The state of one endpoint of ``hub.open``."""

    CONNECTED = "connected"
    CONNECTING = "connecting"
    LISTENING = "listening"
    REFUSED = "refused"
    UNREACHABLE = "unreachable"
    NOT_ANSWERING = "not answering"
    NO_SESSION = "no session"
    CLOSED = "closed"

    @property
    def good(self) -> bool:
        """Whether the state requires no action."""
        return self in (EndpointState.CONNECTED, EndpointState.CONNECTING, EndpointState.LISTENING)


@dataclass(frozen=True, slots=True)
class Reason:
    """The state of an endpoint, its reason, and how to fix it ("" if nothing has to be done or no cure is known)."""

    state: EndpointState
    text: str = ""
    cure: str = ""


_SAME_FOLDER = "copy ca.pem and each machine's certificate from the same folder of 'midspan keys'"
_RENEW = "'midspan keys make NAME --replace' renews it, then copy the files"
_CLOCKS = "compare the clocks of both machines"
_NAMES = "'midspan keys make NAME ADDRESS --replace' with every name and address under which others connect"

_CAUSES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    # BadCertificate and CertificateUnknown do not name the problem; rustls sends the former for a wrong name
    (("notvalidyet", "notyetvalid"), "is not valid yet", _CLOCKS),
    (("expired",), "has expired", _RENEW),
    (
        ("badsignature", "unknownissuer", "unknownca", "decrypterror", "localissuer", "selfsigned", "signaturefailure"),
        "is from another authority",
        _SAME_FOLDER,
    ),
    (
        ("notvalidforname", "mismatch", "badcertificate"),
        "is not for the name or address in the endpoint",
        _NAMES,
    ),
)
_MISSING = ("nocertificate", "certificaterequired")
_ALERT = re.compile(r"alert|error_code|ConnectionClosed", re.IGNORECASE)
_EARLY_ALERTS = ("expired", "badcertificate")
"""Alerts for a certificate that is not valid yet, of rustls and of OpenSSL, in addition to their other meanings."""


def refused_certificate(error: str, detail: str = "") -> Reason:
    """Return why this machine does not accept the other's certificate; ``detail``: its names, authority or dates."""
    wrong, cure = _cause(error)
    return Reason(EndpointState.REFUSED, f"the other machine's certificate {wrong}{detail}", cure)


def refused_by_other(error: str) -> Reason:
    """Return why the other machine does not accept this machine's certificate, from the TLS alert that it sends."""
    if _has(error, _MISSING):
        return Reason(EndpointState.REFUSED, "the other machine asks for a certificate, and gets none", _SAME_FOLDER)
    wrong, cure = _cause_in_alert(error)
    return Reason(
        EndpointState.REFUSED, f"the other machine does not accept this machine's certificate: it {wrong}", cure
    )


def refusal_in_log(error: str, caller: str = "") -> Reason | None:
    """Return why a listener's connection failed, from zenoh's log; None if the entry is not about a certificate."""
    peer = f"a machine at {caller}" if caller else "a machine"
    if _has(error, _MISSING):
        return Reason(EndpointState.REFUSED, f"{peer} connects without a certificate", _SAME_FOLDER)
    if "certificate" not in error.lower() and not _ALERT.search(error):
        return None
    if _ALERT.search(error):
        wrong, cure = _cause_in_alert(error)
        text = f"{peer} does not accept this machine's certificate: it {wrong}"
    else:
        wrong, cure = _cause(error)
        text = f"{peer} is refused: its certificate {wrong}"
    return Reason(EndpointState.REFUSED, text, cure)


def unreachable(err: OSError, place: str) -> Reason:
    """Return why a connection to ``place`` (host:port) failed."""
    host = place.rpartition(":")[0]
    match err:
        case socket.gaierror():
            return Reason(
                EndpointState.UNREACHABLE,
                f"the name {host} cannot be resolved",
                f"put {host} into DNS or /etc/hosts, or connect by address",
            )
        case ConnectionRefusedError():
            return Reason(
                EndpointState.NOT_ANSWERING,
                f"nothing listens at {place}",
                "start Midspan there, and compare the port with its hub.open.listen",
            )
        case TimeoutError():
            return Reason(
                EndpointState.NOT_ANSWERING,
                f"no answer from {place}",
                "switch that machine on, compare the address, and open the port in its firewall",
            )
    if err.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN, errno.EHOSTDOWN):
        cure = "connect this machine to that network, and compare the address"
        return Reason(EndpointState.UNREACHABLE, f"no route to {host}", cure)
    return Reason(EndpointState.UNREACHABLE, f"cannot connect to {place}: {err.strerror or err}")


def _cause(error: str) -> tuple[str, str]:
    for phrases, wrong, cure in _CAUSES:
        if _has(error, phrases):
            return wrong, cure
    return f"is not accepted ({error})", "'midspan keys show FILE' prints a certificate"


def _cause_in_alert(error: str) -> tuple[str, str]:
    wrong, cure = _cause(error)
    if _has(error, _EARLY_ALERTS):
        return f"{wrong}, or is not valid yet by the other machine's clock", f"{_CLOCKS}; {cure}"
    return wrong, cure


def _has(error: str, words: tuple[str, ...]) -> bool:
    squeezed = re.sub(r"[^a-z]", "", error.lower())
    return any(phrase in squeezed for phrase in words)
