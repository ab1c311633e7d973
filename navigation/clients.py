"""Whether anybody is left who could stop a robot."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from bridge.modules.action_server import ActionServer, Goal
from bridge.modules.host import Host

_EVERY = 0.25
_LOOKS = 3
"""So often in a row nobody is seen before that counts: a link may be made again."""

GONE = "who gave the goal is gone, and nobody is left who could cancel it"
CUT_OFF = "who gave the goal is on another machine, and is not seen any more: the link is cut, or the program has ended"


class Clients:
    """Watches the clients of an action while it has a goal: where all have gone, their link was cut.

    Args:
        host: the module's.
        server: of the action.
        gone: called once all have gone that were there, while a goal is under way.
    """

    def __init__(self, host: Host, server: ActionServer, gone: Callable[[], None]) -> None:
        self._server, self._gone = server, gone
        self._seen, self._missed = False, 0
        host.loop.every(_EVERY, self._look)

    def _look(self) -> None:
        if not self._server.active:
            self._seen, self._missed = False, 0
        elif self._server.clients:
            self._seen, self._missed = True, 0
        elif self._seen:
            self._missed += 1
            if self._missed >= _LOOKS:
                self._seen = False
                self._gone()


@dataclass
class _Far:
    """What is known of a goal's client: whether it is of this machine, was seen at all, and so often was not lately."""

    near: bool = False
    seen: bool = False
    missed: int = 0


class FarClients:
    """Watches who gave goals from other machines: whoever is cut off can stop no robot, whoever else could.

    A client of this machine may end, and its goal goes on. It is told from others by its direct link.

    Args:
        host: the module's.
        server: of the action.
        gone: called with a goal once its client is not there any more.
    """

    def __init__(self, host: Host, server: ActionServer, gone: Callable[[Goal], None]) -> None:
        self._hub, self._server, self._gone = host.node.hub, server, gone
        self._known: dict[bytes, _Far] = {}
        server.met = self._meet
        host.loop.every(_EVERY, self._look)

    def _meet(self, goal: Goal) -> None:
        """As it comes: whoever sent it may be cut off before the next look."""
        if goal.client:
            self._known[goal.id] = far = _Far()
            self._see(far, goal, self._hub.neighbours())

    def _see(self, far: _Far, goal: Goal, near: Collection[str]) -> None:
        session = self._hub.graph.zid_of(goal.client)
        far.near = far.near or session in near
        far.seen = far.seen or bool(session)
        far.missed = 0 if session else far.missed + 1

    def _look(self) -> None:
        goals = [goal for goal in self._server.active if goal.client]
        self._known = {goal.id: self._known.get(goal.id) or _Far() for goal in goals}
        if not goals:
            return
        near = self._hub.neighbours()
        for goal in goals:
            far = self._known[goal.id]
            self._see(far, goal, near)
            if far.seen and not far.near and far.missed >= _LOOKS:
                self._gone(goal)
