"""The network of a script, in the test's own process: what `yarp.Network` and `yarp.PolyDriver` use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import yarp_compat as yarp
from yarp_compat.naming.client import NameClient
from yarp_compat.os.runtime import RUNTIME


@contextmanager
def network_of(names: NameClient) -> Iterator[None]:
    """Have the network be that of a name server, and close what is open of it at the end."""
    RUNTIME.use(names)
    yarp.Network.init()
    try:
        yield
    finally:
        yarp.Network.fini()
