"""Authentication of the console's clients: tokens, certificates, logins.

A token has 256 random bits; the configuration contains its SHA-256, from which the token cannot be derived. A login
gives the browser a cookie that only this console can make: name and expiry, with an HMAC (RFC 2104) over both and the
token's hash. So a login outlasts a restart, and ends when the token is removed from the configuration.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bridge.config.sections.web import Role, TokenSection, WebSection
from bridge.hub.security.tokens import token_hash

COOKIE = "__Host-midspan"
LOGIN_SECONDS = 30 * 86400
MOST_TOKEN = 200
_SECRET_BYTES = 32

FIRST_WAIT, LONGEST_WAIT = 1.0, 60.0
"""Seconds after an address's first wrong token, twice as many after each further one."""
MOST_WRONG, WRONG_SECONDS = 60, 60.0
"""Wrong tokens of all addresses together in a minute."""
MOST_ADDRESSES = 1000


@dataclass(frozen=True)
class Grant:
    """What a client may do.

    Attributes:
        name: of the token or the certificate, "" without authentication.
        until: seconds since 1970 at which it expires, 0 if it does not.
    """

    name: str
    role: Role
    until: float = 0.0

    @property
    def may_drive(self) -> bool:
        """Whether the client may send commands."""
        return self.role == "drive"


EVERYBODY = Grant("", "drive")
"""For every client on loopback without tokens."""


class TooManyError(RuntimeError):
    """Wrong tokens were tried; the text has the time until the next attempt."""


class Access:
    """Authenticates clients.

    Args:
        section: the configuration.
        secret: this console's key for cookies.
    """

    def __init__(self, section: WebSection, secret: bytes) -> None:
        self.guarded = section.guarded
        self._tokens, self._trusted, self._secret = dict(section.tokens), frozenset(section.trusted), secret
        self._slow = Slowness()

    def grant(self, headers: Mapping[str, str], certificate: str, address: str) -> Grant | None:
        """Return who sent a request, None if it is not authenticated.

        Args:
            headers: of the request, by their names in lower case.
            certificate: the name in the client's certificate, "" without one.
            address: the client's.

        Raises:
            TooManyError: its token is not even looked at.
        """
        if not self.guarded:
            return EVERYBODY
        scheme, _, token = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            return self._by_token(token.strip(), address)
        found = self._by_cookie(_cookie(headers.get("cookie", "")))
        if found is None and certificate:
            trusted = certificate in self._trusted or "*" in self._trusted
            found = Grant(certificate, "drive" if trusted else "watch")
        return found

    def login(self, token: str, address: str) -> tuple[Grant, str] | None:
        """Return the token's owner and the cookie; None if the token is unknown. Raises `TooManyError`."""
        grant = self._by_token(token, address)
        if grant is None:
            return None
        end = int(time.time()) + LOGIN_SECONDS
        return grant, f"{grant.name}.{end}.{self._mac(grant.name, str(end), self._tokens[grant.name])}"

    def _by_token(self, token: str, address: str) -> Grant | None:
        self._slow.check(address)
        digest = token_hash(token[: MOST_TOKEN + 1])
        found = None
        for name, each in self._tokens.items():  # all of them, so that the duration reveals nothing
            if hmac.compare_digest(digest, each.sha256):
                found = Grant(name, each.role)
        if found is None:
            self._slow.wrong(address)
        else:
            self._slow.right(address)
        return found

    def _by_cookie(self, value: str) -> Grant | None:
        name, _, rest = value.partition(".")
        end, _, mac = rest.partition(".")
        token = self._tokens.get(name)
        if token is None or not (end.isascii() and end.isdigit() and len(end) < 12):
            return None
        if not hmac.compare_digest(mac.encode(), self._mac(name, end, token).encode()) or int(end) < time.time():
            return None
        return Grant(name, token.role, float(end))

    def _mac(self, name: str, end: str, token: TokenSection) -> str:
        return hmac.new(self._secret, f"{name}.{end}.{token.sha256}".encode(), hashlib.sha256).hexdigest()


class Slowness:
    """Limits attempts with wrong tokens, by address and in total. Safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._wrong: dict[str, tuple[int, float]] = {}  # how many, and when the next may be tried
        self._recent: list[float] = []

    def check(self, address: str) -> None:
        """Raise `TooManyError` if an address has to wait."""
        now = time.monotonic()
        with self._lock:
            self._recent = [at for at in self._recent if now - at < WRONG_SECONDS]
            wait = self._wrong.get(address, (0, 0.0))[1] - now
            if len(self._recent) >= MOST_WRONG:
                wait = max(wait, self._recent[0] + WRONG_SECONDS - now)
        if wait > 0.0:
            raise TooManyError(f"wrong tokens were tried; try again in {wait:.0f} s")

    def wrong(self, address: str) -> None:
        """Record a wrong token of an address."""
        now = time.monotonic()
        with self._lock:
            count = self._wrong.pop(address, (0, 0.0))[0] + 1
            if len(self._wrong) >= MOST_ADDRESSES:
                del self._wrong[next(iter(self._wrong))]  # the oldest
            self._wrong[address] = count, now + min(FIRST_WAIT * 2.0 ** min(count - 1, 20), LONGEST_WAIT)
            self._recent.append(now)

    def right(self, address: str) -> None:
        """Record a valid token of an address."""
        with self._lock:
            self._wrong.pop(address, None)


def kept_secret(folder: Path) -> bytes:
    """Return this console's secret; a new one if it is missing. Raises `RuntimeError` if it cannot be stored."""
    from bridge.hub.security.certificates import write_private

    file = folder / "web.secret"
    try:
        if file.exists() and len(found := file.read_bytes()) == _SECRET_BYTES:
            return found
        made = secrets.token_bytes(_SECRET_BYTES)
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_private(file, made)
    except OSError as err:
        raise RuntimeError(f"{file}: {err.strerror}; the console stores its key for logins there") from None
    return made


def _cookie(header: str) -> str:
    """Return the value of the console's cookie, "" without one."""
    for part in header.split(";"):
        name, _, value = part.strip().partition("=")
        if name == COOKIE:
            return value
    return ""


def common_name(peer: Any) -> str:
    """Return the name in a client's certificate (as `ssl.SSLSocket.getpeercert` returns it), or ""."""
    for part in (peer or {}).get("subject", ()):
        for key, value in part:
            if key == "commonName":
                return str(value)
    return ""
