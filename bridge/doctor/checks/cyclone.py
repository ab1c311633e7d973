"""Reports which ROS 2 nodes run on Cyclone DDS, and which of their services are called on another DDS instead."""

from __future__ import annotations

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
    findings = [_finding(daemon, cyclone) for daemon, cyclone in reports if cyclone is not None and cyclone.nodes]
    return findings or ok("no node uses Cyclone DDS")


def _finding(daemon: str, cyclone: CycloneNodes) -> Finding:
    seen = f"{listed(cyclone.nodes)} on Cyclone DDS, seen by {daemon}"
    if not cyclone.both:
        return ok(f"{seen}: topics, services and actions cross")
    return warn(f"{seen}; also served on another DDS, so they get no calls to {listed(cyclone.both)}", _CURE)


CHECKS = (Check("cyclone", "ROS 2 nodes on Cyclone DDS", check_nodes),)
"""The check of nodes on Cyclone DDS."""
