"""An rmw_zenoh node in a separate process, which a test can freeze. Arguments: router, domain, name, lease in ms.

The node has one subscription, and runs until its standard input ends or it is killed.
"""

from __future__ import annotations

import sys

from bridge.hub.wire.qos import Qos
from tests.peers.zenoh.rmw import CONFIG, RmwNode

TYPE, HASH = "std_msgs/msg/String", "RIHS01_" + "5e" * 32


def main() -> None:
    """Join the hub and wait."""
    router, domain, name, lease = sys.argv[1:]
    CONFIG["transport"]["link"]["tx"]["lease"] = int(lease)
    node = RmwNode(router, int(domain), name)
    node.subscription(f"/{name}", TYPE, HASH, Qos(), lambda _payload: None)
    sys.stdin.read()
    node.close()


if __name__ == "__main__":
    main()
