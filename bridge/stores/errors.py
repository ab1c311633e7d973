"""What can go wrong with the store."""

from __future__ import annotations


class StoreError(RuntimeError):
    """The store refuses or cannot do what it was asked; nothing has changed, and the text says why."""
