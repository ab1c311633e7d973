"""Authentication of the console's clients: tokens, certificates, logins.

A token has 256 random bits; the configuration contains its SHA-256, from which the token cannot be derived. A login
gives the browser a cookie that only this console can create. It contains name and expiry, with an HMAC (RFC 2104) over
both and the token's hash, so that a login survives a restart, and ends when the configuration no longer has the token.
"""

from __future__ import annotations

import hashlib
import hmac
import math
import secrets
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bridge.config.sections.listen import Role, TokenSection
from bridge.hub.security.tokens import token_hash
from bridge.web.section import WebSection
from bridge.web.serving.scarce_log import ScarceLog

COOKIE = "__Host-midspan"
LOGIN_SECONDS = 30 * 86400
MOST_TOKEN = 200  # characters of a token
_SECRET_BYTES = 32

FIRST_WAIT, LONGEST_WAIT = 1.0, 60.0
"""Seconds for which a wrong token is refused with 429 after its first use, and the maximum; each further use doubles
them."""
MOST_WRONG = 20
"""Maximum number of wrong tokens of one address that are counted separately; further tokens share one entry."""
MOST_ENTRIES = 1000  # maximum number of counted wrong tokens of all addresses
FORGET_SECONDS = 600.0  # time since its last use after which a wrong token is no longer counted
LOG_SECONDS = 600.0
"""Minimum time between two log lines about the same wrong token of an address."""


@dataclass(frozen=True)
class Grant:
    """Name and role of a client.

    Attributes:
        name: the name of the token or the certificate; "" without authentication.
        until: seconds since 1970 at which the grant expires; 0 if it does not expire.
    """

    name: str
    role: Role
    until: float = 0.0

    @property
    def may_drive(self) -> bool:
        """Whether the client may send commands."""
        return self.role == "drive"


EVERYBODY = Grant("", "drive")
"""The grant of every client of a console on loopback without tokens."""


class WrongTokenError(RuntimeError):
    """A token is unknown.

    Attributes:
        wait: seconds until the client may try the token again, if it tried too early; else 0.
    """

    def __init__(self, wait: int = 0) -> None:
        again = f"; it was tried before: wait {wait} s, or use a valid token" if wait else ""
        super().__init__(f"no such token{again}")
        self.wait = wait

    @property
    def headers(self) -> dict[str, str]:
        """HTTP headers of the refusal. They close the connection, because the connections of an address are limited."""
        return {"connection": "close", **({"retry-after": str(self.wait)} if self.wait else {})}


class Access:
    """Authenticates clients.

    Args:
        section: the configuration.
        secret: this console's key for cookies.
        key: the configuration's key of the tokens, for the log.
        log: receives warnings about wrong tokens.

    Attributes:
        prefix: path at which a reverse proxy serves the console.
        cookie: name of the login's cookie; consoles at several prefixes of one proxy have different names.
    """

    def __init__(
        self, section: WebSection, secret: bytes, *, key: str = "web.tokens", log: ScarceLog | None = None
    ) -> None:
        self.guarded, self.prefix = section.guarded, section.prefix
        self.cookie = COOKIE + section.prefix.replace("/", "~")
        self._tokens, self._trusted, self._secret = dict(section.tokens), frozenset(section.trusted), secret
        self._wrong = WrongTokens(log or ScarceLog(), key)

    def grant(self, headers: Mapping[str, str], certificate: str, address: str) -> Grant | None:
        """Return the client's grant; None if the client is not authenticated.

        Args:
            headers: the request's headers, by lower-case name.
            certificate: the name in the client's certificate; "" without one.
            address: the client's address.

        Raises:
            WrongTokenError: the client's token is unknown.
        """
        if not self.guarded:
            return EVERYBODY
        scheme, _, token = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and token.strip():
            return self._by_token(token.strip(), address, sender(headers))
        grant = self._by_cookie(_cookie(headers.get("cookie", ""), self.cookie))
        if grant is None and certificate:
            trusted = certificate in self._trusted or "*" in self._trusted
            grant = Grant(certificate, "drive" if trusted else "watch")
        return grant

    def login(self, token: str, address: str, program: str = "program ''") -> tuple[Grant, str]:
        """Return a token's grant and the value of the cookie; raises `WrongTokenError`. ``program``: see `sender`."""
        grant = self._by_token(token, address, program)
        end = int(time.time()) + LOGIN_SECONDS
        return grant, f"{grant.name}.{end}.{self._mac(grant.name, str(end), self._tokens[grant.name])}"

    def _by_token(self, token: str, address: str, program: str) -> Grant:
        digest = token_hash(token[: MOST_TOKEN + 1])
        grant = None
        for name, section in self._tokens.items():  # all of them, so that the duration reveals nothing
            if hmac.compare_digest(digest, section.sha256):
                grant = Grant(name, section.role)
        if grant is None:
            raise WrongTokenError(self._wrong.refuse(address, digest, program))
        return grant

    def _by_cookie(self, value: str) -> Grant | None:
        name, _, signed = value.partition(".")
        end, _, mac = signed.partition(".")
        token = self._tokens.get(name)
        if token is None or not (end.isascii() and end.isdigit() and len(end) < 12):
            return None
        if not hmac.compare_digest(mac.encode(), self._mac(name, end, token).encode()) or int(end) < time.time():
            return None
        return Grant(name, token.role, float(end))

    def _mac(self, name: str, end: str, token: TokenSection) -> str:
        return hmac.new(self._secret, f"{name}.{end}.{token.sha256}".encode(), hashlib.sha256).hexdigest()


@dataclass(slots=True)
class _Attempts:
    """Requests of one address with one wrong token."""

    count: int = 0  # requests that were not refused with 429
    until: float = 0.0  # further requests before this time are refused with 429
    last: float = 0.0
    logged: float = -math.inf
    unlogged: int = 0

    def pop_due(self, now: float) -> int:
        """Return the number of requests for the log's next line; 0 if no line is due."""
        if now - self.logged < LOG_SECONDS:
            return 0
        requests, self.unlogged, self.logged = self.unlogged, 0, now
        return requests


def sender(headers: Mapping[str, str]) -> str:
    """Describe a request's program for the log, and the client that a proxy names; neither is verified."""
    program = f"program {headers.get('user-agent', '')[:80]!r}"
    forwarded = headers.get("x-forwarded-for", "")
    return f"{program}, forwarded for {forwarded[:80]!r}" if forwarded else program


class WrongTokens:
    """Counts the wrong tokens of each address. Safe to use from any thread.

    A valid token is never counted or delayed, because many clients may share an address (a proxy, a NAT, one machine),
    and 256 random bits cannot be guessed. The waiting time of a wrong token only slows down its client's requests.
    """

    def __init__(self, log: ScarceLog, key: str) -> None:
        self._log, self._key = log, key
        self._lock = threading.Lock()
        self._attempts: dict[tuple[str, str], _Attempts] = {}  # by address and hash, the most recent at the end

    def refuse(self, address: str, digest: str, program: str) -> int:
        """Record a wrong token; return the seconds that the client has to wait; 0 for the token's first use.

        ``program`` is the result of `sender`.
        """
        now = time.monotonic()
        with self._lock:
            attempts, several = self._entry(address, digest, now)
            attempts.last = now
            attempts.unlogged += 1
            wait = attempts.until - now
            if wait <= 0.0:
                attempts.count += 1
                attempts.until = now + min(FIRST_WAIT * 2.0 ** min(attempts.count - 1, 20), LONGEST_WAIT)
            requests = attempts.pop_due(now)
        if requests:
            token = f"over {MOST_WRONG} different tokens; none is" if several else "a token that is not"
            times = "" if requests == 1 else f" {requests} times since the last such line"
            self._log.warn(f"{address} ({program}) sent {token} in {self._key}{times}")
        return max(math.ceil(wait), 0)

    def _entry(self, address: str, digest: str, now: float) -> tuple[_Attempts, bool]:
        """Return the attempts with a token, and whether other tokens of the address are counted with them."""
        attempts = self._attempts
        while attempts:
            oldest = next(iter(attempts))
            if len(attempts) < MOST_ENTRIES and now - attempts[oldest].last <= FORGET_SECONDS:
                break
            del attempts[oldest]
        key = (address, digest)
        several = key not in attempts and sum(known == address for known, _ in attempts) >= MOST_WRONG
        if several:
            key = (address, "")
        attempts[key] = attempts.pop(key, _Attempts())
        return attempts[key], several


def stored_secret(folder: Path) -> bytes:
    """Return this console's secret, created if missing or invalid; raises `RuntimeError` if it cannot be stored."""
    from bridge.hub.security.certificates import write_private

    file = folder / "web.secret"
    try:
        if file.exists() and len(secret := file.read_bytes()) == _SECRET_BYTES:
            return secret
        secret_ = secrets.token_bytes(_SECRET_BYTES)
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_private(file, secret_)
    except OSError as err:
        raise RuntimeError(f"{file}: {err.strerror}; the console stores its key for logins there") from None
    return secret_


def _cookie(header: str, wanted: str) -> str:
    """Return the value of a cookie; "" if it is missing."""
    for part in header.split(";"):
        name, _, value = part.strip().partition("=")
        if name == wanted:
            return value
    return ""


def common_name(peer: Any) -> str:
    """Return the name in a client's certificate (as `ssl.SSLSocket.getpeercert` returns it), or ""."""
    for part in (peer or {}).get("subject", ()):
        for key, value in part:
            if key == "commonName":
                return str(value)
    return ""
