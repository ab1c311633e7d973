"""File names that come from users, programs and configurations: Windows forbids many of them.

On Windows, ``a:b`` is a hidden stream of ``a``, ``CON.mcap`` is the console, and ``floor.`` loses its dot, all without
an error. Code that derives a file name from such a name rejects a `forbidden` name if the user can choose another, and
uses the name `escaped` otherwise.
"""

from __future__ import annotations

import re
import sys

_FORBIDDEN = re.compile(
    r"""[<>:"|?*\x00-\x1f]|[. ]$|"""
    r"""^(?=(?:con|prn|aux|nul|conin\$|conout\$|(?:com|lpt)[0-9\u00b9\u00b2\u00b3]) *(?:\.|$)).""",
    re.IGNORECASE,
)
"""The forbidden parts of a file name (learn.microsoft.com, "Naming Files, Paths, and Namespaces")."""


def forbidden(name: str) -> str:
    """Return why a name is not a file name on this machine, as a predicate ("is not ..."); "" if it is valid."""
    if sys.platform != "win32" or not _FORBIDDEN.search(name):
        return ""
    return (
        'is not a file name on Windows, which forbids <>:"|?*, control characters, a final dot or space, and the names'
        " of devices, such as CON or COM1; choose another name"
    )


def escaped(name: str) -> str:
    """Return a file name with forbidden characters replaced by their codes (``%43ON``)."""
    return _FORBIDDEN.sub(lambda sign: f"%{ord(sign[0]):02X}", name) if forbidden(name) else name
