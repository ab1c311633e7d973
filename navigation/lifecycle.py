"""Explains the states of a planner's lifecycle nodes to people; ``lifecycle_msgs/msg/State`` names the states."""

from __future__ import annotations

from collections.abc import Mapping

ACTIVE, INACTIVE, UNCONFIGURED, FINALIZED = "active", "inactive", "unconfigured", "finalized"
SILENT = "does not answer"


def trouble(states: Mapping[str, str]) -> str:
    """Return which nodes are not active, by their states; "" if there is none."""
    if not states:
        return ""
    nodes = ", ".join(f"{node.lstrip('/')} ({state})" for node, state in states.items())
    return f"lifecycle nodes of the planner are not active: {nodes}"


def cure(states: Mapping[str, str]) -> str:
    """Return what makes the nodes active, "" if all are."""
    kinds = set(states.values())
    if not kinds:
        return ""
    if kinds == {UNCONFIGURED}:
        return "midspan nav startup"
    if kinds == {INACTIVE}:
        return "midspan nav activate"
    if kinds <= {UNCONFIGURED, INACTIVE}:
        return "midspan nav reset, then midspan nav startup"
    if kinds & {SILENT, FINALIZED}:
        return "start these nodes again, then: midspan nav startup"
    return "wait for the transition to end; if it does not: midspan nav reset, then midspan nav startup"
