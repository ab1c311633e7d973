"""Small files that a worker wants to know again: where one cannot be written it is told, and nothing else stops."""

from __future__ import annotations

import contextlib
import logging
import os
from pathlib import Path

_log = logging.getLogger(__name__)


def keep(file: Path, text: str, loss: str) -> bool:
    """Write a file whole or not at all, and its folder where that is missing.

    Args:
        file: in the state folder.
        text: what to keep.
        loss: what it means that it is not kept, for the log.

    Returns:
        Whether it was written.
    """
    making = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        making.write_text(text, encoding="utf-8")
        making.replace(file)
    except OSError as err:
        _log.warning("cannot write %s: %s; %s", file, err.strerror, loss)
        with contextlib.suppress(OSError):
            making.unlink()
        return False
    return True
