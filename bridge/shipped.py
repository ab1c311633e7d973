"""Files that ship with Midspan, other than its Python packages: configurations, units, the demo's programs.

A checkout has them in its folders. A wheel puts them below ``share/midspan`` of its prefix: a virtual environment, the
user's or the system's. The installer's list of files has their paths
(https://packaging.python.org/en/latest/specifications/recording-installed-packages/).
"""

from __future__ import annotations

import functools
import importlib.metadata
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]
_MARK = "configs/default.yaml"


@functools.cache
def shipped_folder() -> Path:
    """Return the folder with ``configs``, ``examples`` and ``packaging``; raises `RuntimeError` without one."""
    if (CHECKOUT / _MARK).is_file():
        return CHECKOUT
    try:
        listed = importlib.metadata.files("midspan") or []
    except importlib.metadata.PackageNotFoundError:
        listed = []
    for path in listed:
        if path.as_posix().endswith(f"share/midspan/{_MARK}"):
            return Path(str(path.locate())).resolve().parents[1]
    raise RuntimeError("Midspan's configurations and units are missing from this installation; install it again")
