"""Cancels the goals of a planner if their client, the gateway, left or lost its connection before the reply.

The lost reply would have accepted the goal, or been its result. No other client knows that goal, so no other could stop
the robot.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from bridge.concurrency import DelayedCalls
from bridge.hub.endpoints.calls import Abandon, Call, CallError
from bridge.messages.actions import CANCEL_GOAL, CancelCode, part_name

_log = logging.getLogger(__name__)

PAUSE_SECONDS = 1.0
"""Pause before a cancel request without effect or reply is repeated."""

_REPEATS = 10
"""How often it is repeated: the planner may have rejected the goal, and then it never knows it."""

_HEADER = b"\x00\x01\x00\x00"
_UUID = slice(4, 20)
"""A goal's id in a ``SendGoal`` or ``GetResult`` request, after the encapsulation header; in ``CancelGoal`` a stamp
follows."""

_CODE = 4
"""Offset of the return code in a ``CancelGoal`` response."""

_EFFECTIVE = (CancelCode.NONE, CancelCode.GOAL_TERMINATED)


@dataclass(eq=False, slots=True)
class _Orphan:
    """A goal to cancel: ``calls`` end the requests that were made, ``code`` is the last reply's, None before it."""

    action: str
    request: bytes
    repeats: int
    calls: list[Abandon] = field(default_factory=list)
    code: int | None = None

    def on_reply(self, reply: bytes | CallError) -> None:
        """Note the reply, unless an earlier one was effective; called on any thread."""
        if self.code not in _EFFECTIVE:
            self.code = reply[_CODE] if isinstance(reply, bytes) and len(reply) > _CODE else CancelCode.REJECTED


class OrphanCancels:
    """Cancels orphaned goals. Safe to use from any thread.

    A request is repeated, because it may be lost, or overtake its goal: the two take different connections to a server,
    which accepts a goal that arrives after its cancel request. Calls without a reply are abandoned only at the end,
    because a side may hold a request back for seconds.

    Args:
        later: makes delayed calls.
        find: returns the route of a service on the hub, None if there is none.
    """

    def __init__(self, later: DelayedCalls, find: Callable[[str], Call | None]) -> None:
        self._later, self._find = later, find

    def cancel(self, action: str, request: bytes) -> None:
        """Cancel the goal of a ``SendGoal`` or ``GetResult`` request that has no client any more."""
        if len(request) < _UUID.stop:
            return
        _log.warning("the client that sent a goal to %s has left: canceling the goal", action)
        self._send(_Orphan(action, _HEADER + request[_UUID] + bytes(8), _REPEATS))

    def _send(self, orphan: _Orphan) -> None:
        call = self._find(part_name(orphan.action, CANCEL_GOAL))
        if call is not None:
            orphan.calls.append(call(orphan.request, orphan.on_reply))
        self._later.after(PAUSE_SECONDS, partial(self._check, orphan))

    def _check(self, orphan: _Orphan) -> None:
        """Repeat the request if it had no effect; at the end, abandon the calls without a reply."""
        if orphan.code not in _EFFECTIVE and orphan.repeats:
            orphan.repeats -= 1
            self._send(orphan)
            return
        for abandon in orphan.calls:
            abandon()
        if orphan.code not in (*_EFFECTIVE, CancelCode.UNKNOWN_GOAL_ID):
            _log.warning("%s did not cancel the goal of a client that has left", orphan.action)
