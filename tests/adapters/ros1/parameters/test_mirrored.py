"""One rule whose parameters a ROS 2 node owns, without the node and the master."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, cast

from bridge.adapters.ros1.parameters.mirrored import MirroredNode
from bridge.adapters.ros1.parameters.store import ParameterContext, TakenNames
from tests.peers.ros1.parameters import REGISTRY, double, rule


class Store:
    """A parameter server with one value, ``/top``; it records the reported problems at each read of the names."""

    def __init__(self) -> None:
        self.copies: frozenset[str] = frozenset()
        self.reported: list[Mapping[str, str]] = []
        self.node: MirroredNode | None = None

    def watch(self, keys: Sequence[str]) -> dict[str, Any]:
        return {key: {} for key in keys}

    def taken(self, _without: Collection[str]) -> TakenNames:
        assert self.node is not None
        self.reported.append(self.node.troubles)
        return TakenNames(["/top"])

    def copy(self, _values: Mapping[str, Any], _copies: Collection[str]) -> list[str]:
        return []


def test_problems_are_reported_while_the_next_comparison_reads_the_master() -> None:
    """The status document would otherwise miss them now and then."""
    unused, store = cast("Any", None), Store()
    context = ParameterContext(unused, REGISTRY, cast("Any", store), unused)
    node = store.node = MirroredNode(rule("ros2", "/top/below", "/node"), context, unused)
    for _ in range(2):
        node._on_values(["speed"], {"values": [double(1.5).message()]})
    first, second = store.reported
    assert first == {}
    assert list(second) == ["/top/below/speed"]
    assert second == node.troubles
