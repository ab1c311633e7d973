"""Whether anybody is left who could stop a robot."""

from __future__ import annotations

from collections.abc import Callable

from bridge.modules.action_server import ActionServer
from bridge.modules.host import Host

_EVERY = 0.25
_LOOKS = 3
"""So often in a row nobody is seen before that counts: a link may be made again."""

GONE = "who gave the goal is gone, and nobody is left who could cancel it"


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
