"""The version of the protocol between Midspan processes on the hub: graph, control plane, store, election.

The form is ``<major>.<minor>``: additions of a newer minor version are ignored, and a different major version is
incompatible and refused. Releases that do not announce a version use 1.0.
"""

from __future__ import annotations

import re

MAJOR = 1
WIRE = f"{MAJOR}.0"

_VERSION = re.compile(r"([0-9]{1,5})\.[0-9]{1,5}")


def refusal(version: object) -> str:
    """Return why a peer's version is refused, "" if it is compatible; None (no version) is compatible."""
    if version is None:
        return ""
    match = _VERSION.fullmatch(version) if isinstance(version, str) else None
    if match is None:
        return f"its protocol version {version!r:.40} is invalid"
    if int(match[1]) == MAJOR:
        return ""
    return f"it uses version {version} of Midspan's protocol, and this Midspan {WIRE}; install the same release on both"
