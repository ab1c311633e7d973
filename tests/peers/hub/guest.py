"""A zenoh peer with an untrusted certificate, which tries to join the hub and to publish velocities.

Usage: guest.py KEYS ENDPOINT LISTEN. Prints JSON: the peer's links, and the hub topics that it discovers.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import zenoh

from bridge.hub.wire.keys import pack_attachment
from bridge.hub.zenoh_config import make_config, session_tree
from bridge.messages.registry import Registry

TWIST = "geometry_msgs/msg/Twist"


def main(keys: Path, endpoint: str, listen: str) -> None:
    """Try to join for ten seconds, publish forged commands for two, and print the result."""
    tree = session_tree(endpoint, shared_memory=False, max_payload=1 << 20)
    tls = {
        "root_ca_certificate": str(keys / "ca.pem"),
        "connect_certificate": str(keys / "visitor.pem"),
        "connect_private_key": str(keys / "visitor.key"),
        "enable_mtls": True,
    }
    over = {"listen": {"endpoints": [listen]}, "transport": {"link": {"tls": tls}}}
    type_hash = Registry().ros2(TWIST).type_id
    forged = b"\0\1\0\0" + bytes.fromhex("0000000000805040") + bytes(40)
    with zenoh.open(make_config(tree, over)) as session:
        end = time.monotonic() + 10
        while not session.info.links() and time.monotonic() < end:
            time.sleep(0.05)
        end = time.monotonic() + 2
        number = 0
        while time.monotonic() < end:
            number += 1
            attachment = pack_attachment(number, time.time_ns(), bytes(16))
            for key in (f"0/cmd_vel/geometry_msgs::msg::dds_::Twist_/{type_hash}", "0/cmd_vel/**", "**"):
                session.put(key, forged, attachment=attachment)
            time.sleep(0.1)
        links = sorted({str(link.dst) for link in session.info.links()})
        tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/**") if reply.ok]
        print(json.dumps({"links": links, "topics": tokens}))


main(Path(sys.argv[1]), sys.argv[2], sys.argv[3])
