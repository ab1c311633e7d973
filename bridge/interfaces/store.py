"""The cache of built packages: a folder that several processes and several checkouts share.

::

    <cache>/packages/<package>-<key>/   one built package: a small prefix, never changed once it is there
    <cache>/sets/<key>/                 a prefix of links to several of them: what programs use
    <cache>/locks/<name>

A key stands for all that the content depends on, so there is nothing to invalidate; the whole cache may be deleted at
any time that no program uses it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bridge.interfaces.errors import BuildError
from bridge.interfaces.ros2 import MARK

SITE = f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
"""Where in a prefix the Python packages are."""

_INDEX = "share/ament_index/resource_index"


def default_cache() -> Path:
    """$MIDSPAN_CACHE, else ``midspan/interfaces`` in $XDG_CACHE_HOME or ~/.cache."""
    named = os.environ.get("MIDSPAN_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "midspan" / "interfaces"


def digest(parts: Iterable[str]) -> str:
    """A short key for a list of texts."""
    whole = hashlib.sha256()
    for part in parts:
        data = part.encode()
        whole.update(len(data).to_bytes(8, "little") + data)
    return whole.hexdigest()[:16]


class Store:
    """The cache folder.

    Args:
        folder: where it is; made when something is built.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()

    def package(self, name: str, key: str) -> Path:
        """Where a built package is, or will be."""
        return self.folder / "packages" / f"{name}-{key}"

    def packages(self) -> list[Path]:
        """All built packages, whole ones only."""
        folder = self.folder / "packages"
        return sorted(entry for entry in folder.iterdir() if entry.name[0] != ".") if folder.is_dir() else []

    @contextmanager
    def adding(self, final: Path) -> Iterator[Path | None]:
        """Hold a prefix's lock and offer a folder to fill, which becomes ``final`` as a whole or not at all.

        Yields None where another process had it ready meanwhile. Waits while another one builds the same.
        """
        import fcntl

        try:
            (self.folder / "locks").mkdir(parents=True, exist_ok=True)
            final.parent.mkdir(exist_ok=True)
            lock = (self.folder / "locks" / final.name).open("w")
        except OSError as err:
            raise BuildError(
                f"the cache {self.folder} cannot be written: {err.strerror}", cure="Name another one in $MIDSPAN_CACHE"
            ) from None
        with lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if final.is_dir():
                yield None
                return
            for left in final.parent.glob(f".{final.name}-*"):
                shutil.rmtree(left, ignore_errors=True)  # of a process that was killed while it held the lock
            scratch = Path(tempfile.mkdtemp(prefix=f".{final.name}-", dir=final.parent))
            try:
                scratch.chmod(0o755)
                yield scratch
                scratch.rename(final)
            finally:
                shutil.rmtree(scratch, ignore_errors=True)

    def join(self, packages: Iterable[Path]) -> Path:
        """A prefix that holds all of these built packages, by links."""
        members = sorted(set(packages))
        final = self.folder / "sets" / digest(member.name for member in members)
        if final.is_dir():
            return final
        with self.adding(final) as scratch:
            if scratch is not None:
                for member in members:
                    _link(member, scratch)
                mark = scratch / MARK
                mark.parent.mkdir(parents=True)
                mark.write_text("".join(f"{member.name}\n" for member in members), encoding="utf-8")
        return final


def members(prefix: Path) -> dict[str, Path]:
    """The built packages that a set's prefix holds, by name.

    Raises:
        BuildError: the folder is no such prefix.
    """
    site = prefix / SITE
    if not (prefix / MARK).is_file():
        raise BuildError(f"{prefix} is not a prefix of built interfaces", cure="Run `midspan interfaces build`")
    return {entry.name: entry.resolve().parents[3] for entry in sorted(site.iterdir())} if site.is_dir() else {}


def _link(package: Path, prefix: Path) -> None:
    """Put links to a built package's parts into a prefix; the real folders hold nothing but links."""
    for folder in (SITE, "share", "include", "lib", f"{_INDEX}/packages", f"{_INDEX}/rosidl_interfaces"):
        source, target = package / folder, prefix / folder
        target.mkdir(parents=True, exist_ok=True)
        for entry in sorted(source.iterdir()):
            if entry.name not in ("ament_index", Path(SITE).parent.name):
                link = target / entry.name
                # both folders stay where they are to each other when the set is renamed into place
                link.symlink_to(os.path.relpath(entry, target))
