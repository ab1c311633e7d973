"""Which ROS 2 nodes run on Cyclone DDS, and what does not work with them?"""

from __future__ import annotations

from collections.abc import Sequence

from bridge.doctor.check import Check, Finding, Findings, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.status import CycloneNodes

_SHOWN = 10
_CURE = "nothing to do if only their topics are needed; else run them on Fast DDS: RMW_IMPLEMENTATION=rmw_fastrtps_cpp"


def look_at_nodes(context: CheckContext) -> Findings:
    """Name the nodes on Cyclone DDS that the workers of the ROS 2 side see."""
    documents = context.hub.of_side("ros2")
    if context.hub.error or not documents:
        return skip("no worker of the ROS 2 side answers")
    findings = [_finding(document.daemon, document.cyclone) for document in documents if document.cyclone is not None]
    return findings or ok("no node is on Cyclone DDS")


def _finding(daemon: str, cyclone: CycloneNodes) -> Finding:
    lines = [f"{_listed(cyclone.nodes)} on Cyclone DDS, seen by {daemon}: topics cross"]
    lines.append(_words("services, actions and parameters cannot be called", cyclone.served))
    lines.append(_words("calls by these nodes are not answered", cyclone.called))
    return warn("; ".join(lines), _CURE)


def _words(what: str, names: Sequence[str]) -> str:
    return f"{what} ({_listed(names)})" if names else what


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


CHECKS = (Check("cyclone", "ROS 2 nodes on Cyclone DDS", look_at_nodes),)
"""The check of other middlewares on the ROS 2 side's network."""
