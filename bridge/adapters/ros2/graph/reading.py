"""Reads the graph once, for programs that must not load rclpy.

Run it as ``python -m bridge.adapters.ros2.graph.reading`` in a ros2 worker's environment, with the configuration as
JSON on standard input. It joins with a marked participant, so that a running bridge ignores it.
"""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from bridge.adapters.ros2.dds.choice import dds_of
from bridge.adapters.ros2.graph.graph import Ros2Graph
from bridge.config.model import Config
from bridge.routing.edge import MadeBy

SECONDS = 4.0
"""Seconds of discovery. Most participants respond to the first announcement at once, but a participant with default
settings may be discovered only by its next periodic announcement, up to 3 s later (observed with Fast DDS 2.14.5)."""


def read_graph(config: Config, state: Path, seconds: float) -> dict[str, Any]:
    """Return the other ``midspans`` (GUID prefixes in hex), and the ``nodes`` with visible endpoints."""
    dds = dds_of(config)
    participant, prefix, _ = dds.join(state, "midspan_doctor")
    with contextlib.ExitStack() as stack:
        stack.callback(participant.close)
        graph = Ros2Graph(participant, prefix, lambda _snapshot: None, dds.obstacle)
        stack.callback(graph.stop)
        time.sleep(seconds)
        snapshot = graph.read()
    return {
        "midspans": sorted(p.hex() for p in snapshot.participants if participant.marks.made_by(p) is MadeBy.MIDSPAN),
        "nodes": sorted({endpoint.node for endpoint in snapshot.endpoints}),
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="midspan-look-") as folder:
        try:
            document = read_graph(Config.model_validate_json(sys.stdin.buffer.read()), Path(folder), SECONDS)
        except RuntimeError as err:
            sys.exit(str(err))
    print(json.dumps(document))  # noqa: T201  the result
