"""Files that ship with Midspan, other than its Python packages: configurations, service units, the demo's programs.

A checkout contains them. A wheel installs them below ``share/midspan`` in the prefix of a virtual environment, of the
user or of the system. Their paths are in the list of installed files that the installer writes
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
    """Return the folder with ``configs``, ``examples`` and ``packaging``; raises `RuntimeError` if it is missing."""
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
