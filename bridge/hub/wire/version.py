"""The version of what Midspans say to each other on the hub: graph, control plane, store, election.

``<major>.<minor>``: what a minor adds is left out by who does not know it; another major cannot be understood, and is
refused. What the releases say that name no version is 1.0.
"""

from __future__ import annotations

import re

MAJOR = 1
WIRE = f"{MAJOR}.0"

_VERSION = re.compile(r"([0-9]{1,5})\.[0-9]{1,5}")


def refusal(version: object) -> str:
    """Why who says this version cannot be understood, "" where it can; None is said by who names none."""
    if version is None:
        return ""
    said = _VERSION.fullmatch(version) if isinstance(version, str) else None
    if said is None:
        return f"it names {version!r:.40} as the version of Midspan's wire"
    if int(said[1]) == MAJOR:
        return ""
    return f"it speaks version {version} of Midspan's wire, and this Midspan {WIRE}; bring both to one release"
