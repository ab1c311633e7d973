"""Loads ROS 1's messages before anything else does, and without numpy, which is 6 MB.

genpy takes numpy where it is there, to know its floats in the fields of messages that are filled in (genpy 0.6.16,
``message.py``). This worker passes bytes on; it loads numpy itself with the first array that it has to read.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any


def _import_genpy() -> None:
    modules: dict[str, Any] = sys.modules
    if "numpy" in modules:
        return
    modules["numpy"] = None  # importing it is an ImportError meanwhile
    try:
        importlib.import_module("genpy")
    finally:
        del modules["numpy"]


_import_genpy()
