"""Reports which ROS 2 nodes run on Cyclone DDS, and which calls between them and another DDS fail."""

from __future__ import annotations

from collections.abc import Iterator

from bridge.adapters.ros2.graph.vendors import CURE_MIXED
from bridge.doctor.check import Check, Finding, Findings, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.status import CycloneNodes
from bridge.text import listed

_CURE = "stop one of the servers, or rename one with a remapping of its node"


def check_nodes(context: CheckContext) -> Findings:
    """Report the nodes on Cyclone DDS that the workers of the ROS 2 side see."""
    documents = context.hub.of_side("ros2")
    if context.hub.error or not documents:
        return skip("no worker of the ROS 2 side answers")
    reports = ((document.daemon, document.cyclone) for document in documents)
    findings = [
        finding
        for daemon, cyclone in reports
        if cyclone is not None and cyclone.nodes
        for finding in _findings(daemon, cyclone)
    ]
    return findings or ok("no node uses Cyclone DDS")


def _findings(daemon: str, cyclone: CycloneNodes) -> Iterator[Finding]:
    seen = f"{listed(cyclone.nodes)} on Cyclone DDS, seen by {daemon}"
    if cyclone.both:
        served = f"another DDS also serves {listed(cyclone.both)}"
        yield warn(f"{seen}; {served}, so the servers of these nodes get no calls", _CURE)
    if cyclone.mixed:
        pairs = f"native clients and servers on two kinds of DDS: {listed(cyclone.mixed)}"
        lost = "ROS 2 executes these requests with wrong values, and the clients get no replies"
        yield warn(f"{seen}; {pairs}: {lost}", CURE_MIXED)
    if not cyclone.both and not cyclone.mixed:
        yield ok(f"{seen}: topics, services and actions are bridged")


CHECKS = (Check("cyclone", "ROS 2 nodes on Cyclone DDS", check_nodes),)
"""The check of nodes on Cyclone DDS."""
