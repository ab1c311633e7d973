"""Names of files that people, programs and configurations choose, on Windows, which forbids many.

There ``a:b`` is a hidden part of ``a``, ``CON.mcap`` is the console, and ``floor.`` loses its dot, all without an
error. So whoever makes a file's name of such a name asks here: for `forbidden` where somebody can choose another name,
for the name `escaped` where nobody can.
"""

from __future__ import annotations

import re
import sys

_FORBIDDEN = re.compile(
    r"""[<>:"|?*]|[. ]$|^(?=(?:con|prn|aux|nul|conin\$|conout\$|(?:com|lpt)[0-9\u00b9\u00b2\u00b3]) *(?:\.|$)).""",
    re.IGNORECASE,
)
"""A character that spoils a file's name (learn.microsoft.com, "Naming Files, Paths, and Namespaces")."""


def forbidden(name: str) -> str:
    """Why no file here can have a name, after whose it is; "" where this is not Windows, or it can."""
    if sys.platform != "win32" or not _FORBIDDEN.search(name):
        return ""
    return (
        "is no file's name on Windows, which has none of <>:\"|?*, ends neither with a dot nor a blank, and is no"
        " device's, such as CON or COM1; take another name"
    )


def escaped(name: str) -> str:
    """The name of a file; what is forbidden in it here is told by numbers (``%43ON``)."""
    return _FORBIDDEN.sub(lambda sign: f"%{ord(sign[0]):02X}", name) if forbidden(name) else name
