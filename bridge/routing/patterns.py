"""Globs and regular expressions over topic names, and renaming by them."""

from __future__ import annotations

import re
from functools import lru_cache

_WILDCARD = re.compile(r"\*\*|\*|\?")


@lru_cache(maxsize=4096)
def glob_regex(glob: str) -> re.Pattern[str]:
    """Compile a glob: ``*`` and ``?`` stay within one part between slashes, ``**`` crosses parts; each is a group.

    A trailing ``/**`` also matches the name without it, as in ``/camera/**`` for ``/camera``.
    """
    tail = ""
    if glob.endswith("/**"):
        glob, tail = glob[:-3], r"(?:/(.*))?"
    parts = []
    end = 0
    for match in _WILDCARD.finditer(glob):
        parts.append(re.escape(glob[end : match.start()]))
        parts.append({"**": "(.*)", "*": "([^/]*)", "?": "([^/])"}[match.group()])
        end = match.end()
    parts.append(re.escape(glob[end:]))
    return re.compile("".join(parts) + tail)


def rename_glob(match: re.Match[str], new: str) -> str:
    """Fill the wildcards of a new name with what the glob's wildcards matched, in order."""
    groups = iter([g or "" for g in match.groups()])
    renamed = _WILDCARD.sub(lambda _: next(groups, ""), new)
    return renamed.rstrip("/") or "/"
