"""Tokens by which people and programs get in to the console: random, and kept as hashes alone."""

from __future__ import annotations

import hashlib
import secrets


def new_token() -> tuple[str, str]:
    """A token of 256 random bits, and its SHA-256 for the configuration."""
    token = secrets.token_urlsafe(32)
    return token, token_hash(token)


def token_hash(token: str) -> str:
    """What the configuration has of a token."""
    return hashlib.sha256(token.encode(errors="replace")).hexdigest()
