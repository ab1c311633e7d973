"""Access tokens of people and programs for the console: random, and stored only as hashes."""

from __future__ import annotations

import hashlib
import secrets


def new_token() -> tuple[str, str]:
    """Return a token of 256 random bits, and its SHA-256 hash for the configuration."""
    token = secrets.token_urlsafe(32)
    return token, token_hash(token)


def token_hash(token: str) -> str:
    """Return the hash of a token, which the configuration contains."""
    return hashlib.sha256(token.encode(errors="replace")).hexdigest()
