"""YARP in pure Python: ports, names and data that real YARP programs take for their own.

``import yarp_compat as yarp`` runs scripts written for the official Python bindings. A name is loaded when it is used
first, so that importing is quick and what needs no arrays needs no numpy.
"""

from __future__ import annotations

from typing import Any

from yarp_compat import catalogue


def __getattr__(name: str) -> Any:
    found = catalogue.everything() if name == "__all__" else catalogue.find(name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *catalogue.names()})
