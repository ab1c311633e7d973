"""The process's descriptor limit."""

from __future__ import annotations

import contextlib
import resource


def raise_descriptor_limit() -> None:
    """Raise the soft limit to the hard one: each subscribed publisher and each subscriber costs a descriptor.

    The soft limit of 1,024 that most systems start with is used up by some 900 connections.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
