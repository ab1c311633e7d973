"""Compiled code, and where it is kept between starts."""

from __future__ import annotations

import hashlib
import logging
import os
import stat
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numba

_log = logging.getLogger(__name__)
_njit: Any = numba.njit
_setting = threading.RLock()
"""Held while numba's folder, the process's only one, is set for one function: modules compile on their own threads."""


def compiled(
    function: Callable[..., Any], signature: Any, sources: Sequence[Path], make: Any = _njit, **options: Any
) -> Any:
    """Compile a function with numba, or load it from the cache, whose folder is set for this function alone.

    Args:
        function: what is compiled.
        signature: its types.
        sources: the files that go into it, all in one folder; see `cache_folder`.
        make: numba's ``njit`` or ``cfunc``.
        options: of ``make``.
    """
    config: Any = numba.config
    folder = cache_folder(sources)
    with _setting:
        before = config.CACHE_DIR
        try:
            config.CACHE_DIR = "" if folder is None else str(folder)
            return make(signature, cache=folder is not None, **options)(function)
        except OSError as err:
            _log.warning("compiled code cannot be kept in %s: %s; each start compiles it anew", folder, err.strerror)
            return make(signature, **options)(function)
        finally:
            config.CACHE_DIR = before


def entry_point(compiled_function: Any, signature: Any) -> Callable[..., Any]:
    """The machine code of a function that was compiled by ``njit``, without numba's look at the arguments' types."""
    entry: Callable[..., Any] = compiled_function.overloads[signature.args].entry_point
    return entry


def cache_folder(sources: Sequence[Path]) -> Path | None:
    """The folder for the compiled form of ``sources``, which lie in one folder.

    numba looks at the time stamp of one file alone, so that a change in another that is compiled into it would go
    unseen: here the folder's name has a digest of them all.

    Returns:
        A folder in NUMBA_CACHE_DIR, beside the sources, in the service's cache folder (CACHE_DIRECTORY) or in the
        user's (XDG_CACHE_HOME, ~/.cache), or among the temporary files: the first that can be written, and by nobody
        else. None where there is none.
    """
    digest = hashlib.sha256()
    for source in sources:
        digest.update(source.read_bytes())
    name = f"midspan-numba-{digest.hexdigest()[:16]}"
    user = os.getuid() if hasattr(os, "getuid") else 0
    roots = [
        os.environ.get("NUMBA_CACHE_DIR", ""),
        str(sources[0].parent / "__pycache__"),
        os.environ.get("CACHE_DIRECTORY", "").split(":")[0],
        os.environ.get("XDG_CACHE_HOME", ""),
        _home_cache(),
        str(Path(tempfile.gettempdir()) / f"midspan-{user}"),
    ]
    folders = [Path(root) / name for root in roots if root]
    return next((folder for folder in folders if _usable(folder)), None)


def _home_cache() -> str:
    try:
        return str(Path.home() / ".cache")
    except RuntimeError:  # the user has no home
        return ""


def _usable(folder: Path) -> bool:
    """Whether the folder is there, or can be made, is ours to write, and nobody else's."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        status = folder.stat()
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        return False
    if hasattr(os, "getuid") and status.st_uid != os.getuid():
        return False
    return not status.st_mode & (stat.S_IWOTH | stat.S_IWGRP)
