"""Checks the files that a configuration names, before a reload applies their changed contents.

A load accepts files that this user cannot read, and certificates that TLS cannot use, because another user may check a
configuration, and a daemon may start before its certificates are there.
"""

from __future__ import annotations

import stat
from collections.abc import Iterator
from pathlib import Path

from bridge.config.digests import digests, section_of
from bridge.config.model import Config
from bridge.config.sections.section import Section


def check_changed_files(old: Config, new: Config) -> None:
    """Raise `RuntimeError` if a section with changed files names one that cannot be read, or that TLS cannot use."""
    known = dict(digests(old))
    for key, digest in digests(new):
        section = section_of(new, key)
        if section is not None and digest != known.get(key):
            for reason in _troubles(section):
                raise RuntimeError(f"{key}: {reason}")


def _troubles(section: Section) -> Iterator[str]:
    for file in section.named_files():
        if reason := _unreadable(file):
            yield f"cannot read {file}: {reason}"
    for settings in (getattr(section, name, None) for name in ("zenoh", "router_zenoh")):
        if settings and isinstance(settings, dict | Path):
            from bridge.config.zenoh_files import tls_files  # few configurations have zenoh settings
            from bridge.hub.security.key_files import tls_trouble

            yield from filter(None, (tls_trouble(*files) for files in tls_files(settings)))


def _unreadable(file: Path) -> str:
    """Return why this user cannot read a file, "" if it can, or if the file is missing or not a regular one."""
    try:
        if stat.S_ISREG(file.stat().st_mode):
            file.open("rb").close()
    except (FileNotFoundError, NotADirectoryError):
        return ""
    except OSError as err:
        return err.strerror or str(err)
    return ""
