"""DART's Python package, which is published for Linux alone."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from typing import Any

from sim.errors import SimError

_PACKAGE = "dartpy"


def missing() -> str:
    """Why the package is not to be had, "" where it is; it is not imported for that."""
    if importlib.util.find_spec(_PACKAGE) is not None:
        return ""
    published = sys.platform == "linux" and sys.version_info < (3, 14)
    cure = "pip install dartpy" if published else "it is published for Linux with Python 3.10 to 3.13 alone"
    return f"the simulator needs dartpy, which is not installed: {cure}"


@cache
def dartpy() -> Any:
    """The package.

    Raises:
        SimError: it is not installed here, or cannot be loaded.
    """
    if why := missing():
        raise SimError(why)
    try:
        return importlib.import_module(_PACKAGE)
    except ImportError as err:
        msg = f"dartpy cannot be loaded: {err}"
        raise SimError(msg) from None
