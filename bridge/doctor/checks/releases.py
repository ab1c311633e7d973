"""Reports the DDS and the ROS 2 release of each node, and what does not work between different ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bridge.doctor.check import Check, Finding, Findings, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.hub.graph.releases import native_nodes
from bridge.status import Middleware
from bridge.text import listed

_CURE_HASHES = (
    "nothing to do if their message packages have the same definitions as this machine's; otherwise rename their topics"
    " with a rule"
)
_UNNOTICED = "these nodes have no type hashes, so differences between their definitions remain unnoticed"
_CURE_MEMORY = "nothing to do: messages between Fast DDS 2 and Fast DDS 3 use UDP, at a lower rate for large ones"


def check_releases(context: CheckContext) -> Findings:
    """Report the DDS and the release of the nodes on the ROS 2 side and on the hub."""
    if context.hub.error or not context.hub.documents:
        return skip("no worker answers")
    findings = [finding for document in context.hub.of_side("ros2") for finding in _of_side(document.middlewares)]
    findings += _on_hub(context)
    return findings or ok("no ROS 2 node found")


def _of_side(groups: Sequence[Middleware]) -> Iterator[Finding]:
    for group in groups:
        seen = f"{group}: {listed(group.nodes)}"
        if group.ros and not group.hashes:
            yield warn(f"{seen}; {_UNNOTICED}", _CURE_HASHES)
        else:
            yield ok(seen)
    fast = sorted({group.name for group in groups if group.name.startswith("Fast DDS ")})
    if len({name.split()[2].partition(".")[0] for name in fast}) > 1:
        yield warn(f"{' and '.join(fast)} on one network do not share memory with each other", _CURE_MEMORY)


def _on_hub(context: CheckContext) -> Iterator[Finding]:
    midspan = {zid for document in context.hub.documents for zid in document.hub_sessions}
    for group in native_nodes(context.hub.endpoints, midspan):
        seen = f"on the hub: {group}: {listed(group.nodes)}"
        if group.hashless:
            yield warn(f"{seen}; {_UNNOTICED}", _CURE_HASHES)
        else:
            yield ok(seen)


CHECKS = (Check("ros2-releases", "the DDS and the release of ROS 2 nodes", check_releases),)
"""The check of middlewares and releases."""
