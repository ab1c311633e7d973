"""The edges of the zenoh side, one for each dialect that the configuration names."""

from __future__ import annotations

from pathlib import Path

from bridge.adapters.base import Edge
from bridge.adapters.zenoh.json_keys import JsonKeysEdge
from bridge.adapters.zenoh.ros1 import Ros1KeysEdge
from bridge.adapters.zenoh.ros2dds import Ros2ddsEdge
from bridge.config.model import Config
from bridge.config.sections.zenoh import Dialect
from bridge.messages.registry import Registry


def make_edges(config: Config, registry: Registry, state: Path) -> dict[str, Edge]:
    """The edges by name: the side's, with a number behind it from the second of a dialect on."""
    dialects = config.zenoh.dialects
    json_keys = frozenset(str(key.key) for dialect in dialects if dialect.dialect == "json" for key in dialect.keys)
    edges: dict[str, Edge] = {}
    for dialect in dialects:
        edge = _make(dialect, config, registry, state, json_keys)
        number = sum(other.side == edge.side for other in edges.values()) + 1
        edges[edge.side if number == 1 else f"{edge.side}_{number}"] = edge
    return edges


def _make(dialect: Dialect, config: Config, registry: Registry, state: Path, json_keys: frozenset[str]) -> Edge:
    if dialect.dialect == "ros2dds":
        return Ros2ddsEdge(config, dialect, registry, state, json_keys)
    make = JsonKeysEdge if dialect.dialect == "json" else Ros1KeysEdge
    return make(config, dialect, registry, state)
