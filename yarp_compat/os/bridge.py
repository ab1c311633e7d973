"""Midspan's daemon, as a YARP program sees it: ports that are marked at the name server."""

from __future__ import annotations

import logging

from yarp_compat.naming import talk
from yarp_compat.naming.errors import NamingError
from yarp_compat.os.runtime import RUNTIME
from yarp_compat.wire.contact import Contact
from yarp_compat.wire.text import from_text

log = logging.getLogger("yarp.os.Node")

FOLDER = "/midspan/daemon"
"""Below this name each daemon has the port that answers."""

MARK = "midspan_owner"
"""The property at the name server that tells them from others."""


def find() -> Contact | None:
    """A port of a Midspan daemon on this network, or None."""
    return next((c for c in RUNTIME.listed(FOLDER) if RUNTIME.naming.get_property(c.name, MARK)), None)


def definition(type_name: str) -> str | None:
    """The full definition of a message type as a daemon has it; None when there is none, or it does not know."""
    if not RUNTIME.is_up:
        return None
    try:
        daemon = find()
        lines = [] if daemon is None else talk.ask(daemon, ["definition", type_name])
    except NamingError as err:
        log.warning("no daemon tells the definition of %s: %s", type_name, err)
        return None
    words = from_text(lines[0]) if lines else []
    return str(words[1]) if len(words) == 2 and words[0] == "ok" else None
