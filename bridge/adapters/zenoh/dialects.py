"""The edges of the zenoh side, one for each dialect that the configuration names."""

from __future__ import annotations

from pathlib import Path

from bridge.config.model import Config
from bridge.messages.registry import Registry
from bridge.routing.edge import Edge


def make_edges(config: Config, registry: Registry, state: Path) -> dict[str, Edge]:
    """Return the edges by name: the side's name, with a number appended from the second edge of a dialect on."""
    dialects = config.zenoh.dialects
    json_keys = frozenset(str(key.key) for dialect in dialects if dialect.dialect == "json" for key in dialect.keys)
    edges: dict[str, Edge] = {}
    for dialect in dialects:
        edge: Edge
        if dialect.dialect == "ros2dds":  # only the code of the dialects in use is loaded
            from bridge.adapters.zenoh.ros2dds import Ros2ddsEdge

            edge = Ros2ddsEdge(config, dialect, registry, state, json_keys)
        elif dialect.dialect == "json":
            from bridge.adapters.zenoh.json_keys import JsonKeysEdge

            edge = JsonKeysEdge(config, dialect, registry, state)
        else:
            from bridge.adapters.zenoh.ros1 import Ros1KeysEdge

            edge = Ros1KeysEdge(config, dialect, registry, state)
        number = sum(other.side == edge.side for other in edges.values()) + 1
        edges[edge.side if number == 1 else f"{edge.side}_{number}"] = edge
    return edges
