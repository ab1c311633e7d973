"""A YARP network for a script that runs in the test's process; `yarp.Network` and `yarp.PolyDriver` use it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import yarp_compat as yarp
from yarp_compat.naming.client import NameClient
from yarp_compat.os.runtime import RUNTIME


@contextmanager
def network_of(names: NameClient) -> Iterator[None]:
    """Use a name server's network inside the context, and close everything that is still open at the end."""
    RUNTIME.use(names)
    yarp.Network.init()
    try:
        yield
    finally:
        yarp.Network.fini()
