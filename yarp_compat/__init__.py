"""YARP in pure Python: ports, names and data that are compatible with real YARP programs.

``import yarp_compat as yarp`` runs scripts written for the official Python bindings. Names are loaded on first use, so
that the import is fast, and numpy is required only for arrays and devices. Two ports of one program::

    import yarp_compat as yarp

    yarp.Network.init()
    talker, listener = yarp.BufferedPortBottle(), yarp.BufferedPortBottle()
    talker.open("/talker")
    listener.open("/listener")
    yarp.Network.connect("/talker", "/listener")
    talker.prepare().fromString("hello 3.5")
    talker.write()
    print(listener.read().toString())
    yarp.Network.fini()
"""

from __future__ import annotations

from typing import Any

from yarp_compat import catalog


def __getattr__(name: str) -> Any:
    value = catalog.everything() if name == "__all__" else catalog.find(name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *catalog.names()})
