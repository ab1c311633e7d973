"""Imports genpy first, and without numpy, which saves 6 MB.

genpy imports numpy if available, to recognize its floats in message fields (genpy 0.6.16, ``message.py``). This worker
only forwards bytes; it imports numpy itself for the first array that it has to read.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any


def _import_genpy() -> None:
    modules: dict[str, Any] = sys.modules
    if "numpy" in modules:
        return
    modules["numpy"] = None  # meanwhile importing it raises ImportError
    try:
        importlib.import_module("genpy")
    finally:
        del modules["numpy"]


_import_genpy()
