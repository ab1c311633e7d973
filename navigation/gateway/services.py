"""The gateway's services on the hub, for programs of every side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.modules.node import Node
from bridge.modules.services import Answer
from navigation.gateway.gateway import Gateway, RefusedError
from navigation.gateway.places import Places
from navigation.gateway.velocity import Commander

TRIGGER, NAMED = "std_srvs/srv/Trigger", "midspan_msgs/srv/Named"
GET_LOCATION = "midspan_msgs/srv/GetLocation"


class Services:
    """Serves them; all on the module's thread.

    Args:
        node: on which they are served.
        gateway: does what is asked for.
        places: knows where places are.
        commander: takes velocities; they end with a stop.
    """

    def __init__(self, node: Node, gateway: Gateway, places: Places, commander: Commander) -> None:
        self._gateway, self._places, self._commander = gateway, places, commander
        done: dict[str, tuple[str, Callable[[str], str | None]]] = {
            "pause": (TRIGGER, lambda _name: gateway.pause()),
            "resume": (TRIGGER, lambda _name: gateway.resume()),
            "stop": (TRIGGER, lambda _name: self._stop()),
            "choose_planner": (NAMED, gateway.choose),
            "go_to": (NAMED, self._go_to),
        }
        for name, (kind, action) in done.items():
            node.server(f"/navigation/{name}", kind, _serving(action))
        node.server("/navigation/get_location", GET_LOCATION, self._locate)

    def _stop(self) -> str:
        self._commander.stop()
        return self._gateway.stop()

    def _go_to(self, name: str) -> str:
        self._gateway.go([self._places.find(name)], "a caller of /navigation/go_to", name)
        return f"drives to {name}; /navigation/status tells how it gets on"

    def _locate(self, request: dict[str, Any], answer: Answer) -> None:
        try:
            found = self._places.find(str(request["name"]))
        except LookupError as err:
            answer({"success": False, "message": str(err)})
        else:
            answer({"success": True, "message": "", "pose": found.stamped(self._gateway.robot())})


def _serving(action: Callable[[str], str | None]) -> Callable[[dict[str, Any], Answer], None]:
    def serve(request: dict[str, Any], answer: Answer) -> None:
        try:
            said = action(str(request.get("name", "")))
        except (RefusedError, LookupError) as err:
            answer({"success": False, "message": str(err)})
        else:
            answer({"success": True, "message": said or ""})

    return serve
