"""Which ROS 2 nodes run on Cyclone DDS, and which services cannot be called for that reason?"""

from __future__ import annotations

from collections.abc import Sequence

from bridge.doctor.check import Check, Finding, Findings, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.status import CycloneNodes

_SHOWN = 10
_CURE = "stop one of the servers, or rename one by a remapping of its node"


def look_at_nodes(context: CheckContext) -> Findings:
    """Name the nodes on Cyclone DDS that the workers of the ROS 2 side see."""
    documents = context.hub.of_side("ros2")
    if context.hub.error or not documents:
        return skip("no worker of the ROS 2 side answers")
    findings = [_finding(document.daemon, document.cyclone) for document in documents if document.cyclone is not None]
    return findings or ok("no node is on Cyclone DDS")


def _finding(daemon: str, cyclone: CycloneNodes) -> Finding:
    seen = f"{_listed(cyclone.nodes)} on Cyclone DDS, seen by {daemon}"
    if not cyclone.both:
        return ok(f"{seen}: topics, services and actions cross")
    return warn(f"{seen}; also served on another DDS, so that calls are refused: {_listed(cyclone.both)}", _CURE)


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


CHECKS = (Check("cyclone", "ROS 2 nodes on Cyclone DDS", look_at_nodes),)
"""The check of other middlewares on the ROS 2 side's network."""
