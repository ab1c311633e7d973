"""Free ports on loopback, for TCP and UDP."""

from __future__ import annotations

import itertools
import os
import random
import socket

_FIRST, _EACH, _SHARES = 14_000, 2_000, 8
"""Below Linux's ephemeral ports (from 32768 on), which outgoing connections could use before a test opens the port."""

_share = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % _SHARES
_begin = random.SystemRandom().randrange(
    _EACH
)  # random, because other processes of the same test use this function, too
_numbers = itertools.count(_begin)


def free_port(room: int = 0) -> int:
    """Return a free port on 127.0.0.1 that this process has not recently received.

    The next ``room`` ports are free and reserved, too, for a YARP name server that assigns them.
    """
    for _ in range(_EACH):
        number = next(_numbers) % _EACH
        port = _FIRST + _share * _EACH + number
        if number + room < _EACH and all(_is_free(port + above) for above in range(room + 1)):
            for _ in range(room):
                next(_numbers)
            return port
    msg = f"all {_EACH} ports of this pytest worker are in use"
    raise RuntimeError(msg)


def _is_free(port: int) -> bool:
    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):  # ROS 2 programs of other tests have UDP ports in this range
        with socket.socket(type=kind) as sock:
            try:
                sock.bind(("127.0.0.1", port))
            except OSError:
                return False
    return True
