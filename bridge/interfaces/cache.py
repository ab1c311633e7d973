"""The cache of built message packages, shared by processes and checkouts, and how programs use it.

::

    <cache>/packages/<package>-<key>/   one built package: a small prefix, never changed after its creation
    <cache>/sets/<key>/                 a prefix of links to several packages, which programs use
    <cache>/locks/<name>

A key covers everything that the content depends on, so entries are never invalidated; the whole cache may be deleted
while no program uses it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import sysconfig
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from bridge.interfaces.definition import BuildError
from bridge.interfaces.ros2 import MARK, Ros2

SITE = f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
"""Folder of the Python packages within a prefix."""

_INDEX = "share/ament_index/resource_index"


def default_cache() -> Path:
    """Return $MIDSPAN_CACHE, or else ``midspan/interfaces`` in $XDG_CACHE_HOME or ~/.cache."""
    named = os.environ.get("MIDSPAN_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "midspan" / "interfaces"


def digest(parts: Iterable[str]) -> str:
    """Return a short key for a list of texts."""
    hasher = hashlib.sha256()
    for part in parts:
        data = part.encode()
        hasher.update(len(data).to_bytes(8, "little") + data)
    return hasher.hexdigest()[:16]


class BuildCache:
    """The cache folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()

    def package(self, name: str, key: str) -> Path:
        """Return the folder of a built package, which may not exist yet."""
        return self.folder / "packages" / f"{name}-{key}"

    def packages(self) -> list[Path]:
        """Return all completely built packages."""
        folder = self.folder / "packages"
        return sorted(entry for entry in folder.iterdir() if entry.name[0] != ".") if folder.is_dir() else []

    @contextmanager
    def adding(self, final: Path) -> Iterator[Path | None]:
        """Lock a prefix, and yield a folder to fill, which is then renamed to ``final`` atomically.

        Waits while another process builds the same prefix; yields None if the other process has built it.
        """
        import fcntl

        try:
            (self.folder / "locks").mkdir(parents=True, exist_ok=True)
            final.parent.mkdir(exist_ok=True)
            lock = (self.folder / "locks" / final.name).open("w", encoding="utf-8")
        except OSError as err:
            raise BuildError(
                f"the cache {self.folder} cannot be written: {err.strerror}",
                cure="Set $MIDSPAN_CACHE to another folder",
            ) from None
        with lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if final.is_dir():
                yield None
                return
            for leftover in final.parent.glob(f".{final.name}-*"):
                shutil.rmtree(leftover, ignore_errors=True)  # left by a process that was killed during a build
            scratch = Path(tempfile.mkdtemp(prefix=f".{final.name}-", dir=final.parent))
            try:
                scratch.chmod(0o755)
                yield scratch
                scratch.rename(final)
            finally:
                shutil.rmtree(scratch, ignore_errors=True)

    def join(self, packages: Iterable[Path]) -> Path:
        """Return a prefix with links to all of these built packages."""
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
    """Return the built packages in a set's prefix, by name; raises `BuildError` if the folder is not such a prefix."""
    site = prefix / SITE
    if not (prefix / MARK).is_file():
        raise BuildError(f"{prefix} is not a prefix of built interfaces", cure="Run `midspan interfaces build`")
    return {entry.name: entry.resolve().parents[3] for entry in sorted(site.iterdir())} if site.is_dir() else {}


def _link(package: Path, prefix: Path) -> None:
    """Link the contents of a built package into a prefix that consists of folders and links."""
    for folder in (SITE, "share", "include", "lib", f"{_INDEX}/packages", f"{_INDEX}/rosidl_interfaces"):
        source, target = package / folder, prefix / folder
        target.mkdir(parents=True, exist_ok=True)
        for entry in sorted(source.iterdir()):
            if entry.name not in ("ament_index", Path(SITE).parent.name):
                link = target / entry.name
                # relative links stay valid when the set is renamed
                link.symlink_to(os.path.relpath(entry, target))


_PTH = "midspan_interfaces.pth"


def activate(*prefixes: Path) -> tuple[str, ...]:
    """Make the packages of these prefixes importable in this process, ahead of others with the same names.

    A child process needs the variables of `environment`.

    Returns the packages that this process has already imported from elsewhere. Neither Python nor the dynamic loader
    can load a package again, so the new builds need a new process. Raises `BuildError` if two prefixes have different
    builds of one package.
    """
    packages = _merged(prefixes)
    for prefix in reversed(prefixes):
        sys.path[:] = [str(prefix / SITE), *(entry for entry in sys.path if entry != str(prefix / SITE))]
    os.environ["AMENT_PREFIX_PATH"] = _prepend([str(prefix) for prefix in prefixes], "AMENT_PREFIX_PATH")
    return tuple(name for name, folder in packages.items() if _is_loaded_from_elsewhere(name, folder))


def environment(prefixes: Sequence[Path]) -> dict[str, str]:
    """Return the variables with which a new Python process finds ROS 2's libraries and these prefixes' packages.

    Merge them into a copy of `os.environ`. Raises `BuildError` if two prefixes have different builds of one package.
    """
    _merged(prefixes)
    return {
        "PYTHONPATH": _prepend([str(prefix / SITE) for prefix in prefixes], "PYTHONPATH"),
        "AMENT_PREFIX_PATH": _prepend([str(prefix) for prefix in prefixes], "AMENT_PREFIX_PATH"),
        "LD_LIBRARY_PATH": _prepend([str(folder) for folder in Ros2.find().libraries], "LD_LIBRARY_PATH"),
        # the wheels restart Python once to set LD_LIBRARY_PATH, unless this variable marks it as set
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }


def link_into_venv(prefix: Path) -> Path | None:
    """Make a prefix's packages importable in this virtual environment.

    Return the path of the created file, or None outside a virtual environment.
    """
    if sys.prefix == sys.base_prefix:
        return None
    file = Path(sysconfig.get_path("purelib")) / _PTH
    line = f"{prefix / SITE}\n"
    if not file.is_file() or file.read_text(encoding="utf-8") != line:
        scratch = file.with_suffix(".new")
        scratch.write_text(line, encoding="utf-8")
        scratch.replace(file)
    return file


def _merged(prefixes: Iterable[Path]) -> dict[str, Path]:
    """Return the built packages of all prefixes by name."""
    merged: dict[str, Path] = {}
    for prefix in prefixes:
        for name, folder in members(prefix).items():
            if merged.setdefault(name, folder) != folder:
                raise BuildError(
                    f"package {name} is in {prefix} and in another prefix, with different contents",
                    cure="Build all packages that one process uses together, in one call",
                )
    return merged


def _prepend(entries: Sequence[str], variable: str) -> str:
    present = [entry for entry in os.environ.get(variable, "").split(os.pathsep) if entry]
    return os.pathsep.join(dict.fromkeys((*entries, *present)))


def _is_loaded_from_elsewhere(name: str, folder: Path) -> bool:
    module = sys.modules.get(name)
    file = getattr(module, "__file__", None)
    return module is not None and (file is None or not Path(file).resolve().is_relative_to(folder))
