"""The converter of messages whose bytes are the same on both sides."""

from __future__ import annotations


def same(payload: bytes) -> bytes:
    """Return a message unchanged."""
    return payload
