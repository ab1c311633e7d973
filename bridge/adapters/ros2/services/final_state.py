"""Final states in the results of goals: a ROS 2 client waits for one, but on the hub the state may be UNKNOWN."""

from __future__ import annotations

from collections.abc import Callable

from bridge.hub.endpoints.calls import Abandon, Call, Done
from bridge.messages.actions import GoalState

_STATUS = 4
"""Offset of the goal's status in a GetResult response in CDR."""


def refusal_with_final_state(refuse: Callable[[], bytes] | None) -> Callable[[], bytes] | None:
    """Return a function that returns a rejecting GetResult response, with a final state; None without one."""
    return None if refuse is None else lambda: _with_final_state(refuse())


def call_with_final_state(call: Call, request: bytes, done: Done) -> Abandon:
    """Call a GetResult service of the hub; the response that ``done`` gets has a final state."""
    return call(request, lambda reply: done(_with_final_state(reply) if isinstance(reply, bytes) else reply))


def _with_final_state(response: bytes) -> bytes:
    """Return a GetResult response with a final state: UNKNOWN on the hub becomes ABORTED for a ROS 2 client."""
    if response[_STATUS : _STATUS + 1] != bytes([GoalState.UNKNOWN]):
        return response
    return response[:_STATUS] + bytes([GoalState.ABORTED]) + response[_STATUS + 1 :]
