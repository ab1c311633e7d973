"""Services on the hub that pause and step a play, for clients without a terminal, on any side that the rules allow."""

from __future__ import annotations

from typing import Any

from bridge.bags.play.timeline import Timeline
from bridge.clock import SYSTEM
from bridge.hub.control import RECORDED
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from bridge.modules.endpoints import Endpoints
from bridge.modules.loop import EventLoop
from bridge.modules.services import Answer

PREFIX = "/midspan/play"
PAUSE, STEP = f"{PREFIX}/pause", f"{PREFIX}/step"


class PlayServices:
    """``std_srvs/SetBool`` pauses (true) or resumes (false); ``std_srvs/Trigger`` plays one message while paused.

    Args:
        commands: whether commands are played, so that a halt of the robot pauses the play.

    Attributes:
        taken: whether another player has services of these names on the hub.
    """

    def __init__(self, hub: Hub, registry: Registry, timeline: Timeline, *, commands: bool = False) -> None:
        self._timeline = timeline
        self.taken = any(not server.own for server in hub.graph.servers(PAUSE))
        self._loop = EventLoop("midspan-play-services")
        self._loop.start()
        self._node = Endpoints(hub, registry, self._loop, SYSTEM)
        self._node.server(PAUSE, "std_srvs/srv/SetBool", self._pause)
        self._node.server(STEP, "std_srvs/srv/Trigger", self._step)
        self._unserve = hub.serve("halt", self._halt) if commands else None

    def _pause(self, request: dict[str, Any], answer: Answer) -> None:
        paused = bool(request["data"])
        self._timeline.pause(paused)
        answer({"success": True, "message": "paused" if paused else "playing"})

    def _step(self, _request: dict[str, Any], answer: Answer) -> None:
        stepped = self._timeline.step()
        answer({"success": stepped, "message": "" if stepped else f"not paused: call {PAUSE} first"})

    def _halt(self, _params: dict[str, Any]) -> dict[str, Any]:
        """Pause before the halt is confirmed, so that no further velocity is played; called on a thread of the hub."""
        self._timeline.pause(True)
        return RECORDED

    def close(self) -> None:
        if self._unserve is not None:
            self._unserve()
        self._node.close()
        self._loop.close()
