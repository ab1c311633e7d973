"""A program that looks at the ROS 2 network once and prints what it sees as JSON, for those who must not load rclpy.

Run as ``python -m bridge.adapters.ros2.look`` in a ros2 worker's environment, with the configuration as JSON on its
standard input. It joins with a marked participant, so that a running bridge does not take it for a node.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from bridge.config.model import Config

SECONDS = 4.0
"""How long it listens. Most participants answer our first announcement at once, but a stock one may be found only at
its next own, and those come every 3 s (seen with Fast DDS 2.14.5)."""


def look(config: Config, state: Path, seconds: float) -> dict[str, Any]:
    """What is on the network.

    Returns:
        ``participants``: GUID prefixes in hex, without our own; ``nodes``: names of nodes that have endpoints, hidden
        ones left out.
    """
    from bridge.adapters.ros2.environment import domain
    from bridge.adapters.ros2.graph import Graph
    from bridge.adapters.ros2.participant import Participant
    from bridge.adapters.ros2.process import use_profile

    profile = use_profile(config, state)
    participant = Participant("midspan_doctor", domain(config, os.environ))
    try:
        graph = Graph(participant, profile.prefix, lambda _snapshot: None)
        try:
            time.sleep(seconds)
            snapshot = graph.look()
        finally:
            graph.stop()
    finally:
        participant.close()
    return {
        "participants": sorted(prefix.hex() for prefix in snapshot.participants),
        "nodes": sorted({endpoint.node for endpoint in snapshot.endpoints}),
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="midspan-look-") as folder:
        found = look(Config.model_validate_json(sys.stdin.read()), Path(folder), SECONDS)
    print(json.dumps(found))  # noqa: T201  its answer
