"""Which ROS 2 nodes run on Cyclone DDS, and what does not work with them?"""

from __future__ import annotations

from collections.abc import Mapping

from bridge.doctor.check import Check, Finding, Findings, ok, skip, warn
from bridge.doctor.context import CheckContext, Document

_SHOWN = 10
_CURE = "nothing to do if only their topics are needed; else run them on Fast DDS: RMW_IMPLEMENTATION=rmw_fastrtps_cpp"


def look_at_nodes(context: CheckContext) -> Findings:
    """Name the nodes on Cyclone DDS that the workers of the ROS 2 side see."""
    documents = context.hub.of_side("ros2")
    if context.hub.error or not documents:
        return skip("no worker of the ROS 2 side answers")
    findings = [_finding(document) for document in documents if isinstance(document.get("cyclone"), Mapping)]
    return findings or ok("no node is on Cyclone DDS")


def _finding(document: Document) -> Finding:
    cyclone = document["cyclone"]
    lines = [f"{_listed(cyclone.get('nodes'))} on Cyclone DDS, seen by {document.get('daemon')}: topics cross"]
    lines.append(_words("services, actions and parameters cannot be called", cyclone.get("served")))
    lines.append(_words("calls by these nodes are not answered", cyclone.get("called")))
    return warn("; ".join(lines), _CURE)


def _words(what: str, names: object) -> str:
    return f"{what} ({_listed(names)})" if names else what


def _listed(names: object) -> str:
    texts = [str(name) for name in names] if isinstance(names, list) else []
    more = len(texts) - _SHOWN
    return ", ".join(texts[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


CHECKS = (Check("cyclone", "ROS 2 nodes on Cyclone DDS", look_at_nodes),)
"""The check of other middlewares on the ROS 2 side's network."""
