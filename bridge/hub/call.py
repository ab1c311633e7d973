"""What a call of a service is to those between whom it crosses: bytes there, bytes or an error back."""

from __future__ import annotations

from collections.abc import Callable


class CallError(Exception):
    """A call that has no reply; the text says why, to the caller."""


Done = Callable[[bytes | CallError], None]
"""Hears of a call's end, once, on any thread; it only appends and wakes, or sends."""

Abandon = Callable[[], None]
"""The caller is gone: nobody waits for the reply any more. Safe to call twice, and after the end."""

Call = Callable[[bytes, Done], Abandon]
"""``call(request, done)``: begins a call and returns at once; nothing limits how long it takes."""
