"""A module of one's own: it sends the robot to its charger when the battery is low, whoever plans the way.

It hears `/battery_state` (`sensor_msgs/BatteryState`) of any side and asks the gateway to drive. YARP programs hear at
`/charge/status:o` what it does, and tell it `on` or `off` at `/charge/rpc`.
"""

from __future__ import annotations

from typing import Any

from bridge.hub.endpoints.calls import CallError
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.worker import Health


class Charge(Module):
    """Options: ``place``, the charger's location; ``below``, the share of the battery at which it is sought."""

    name = "charge"

    def start(self, host: Host, section: Any) -> None:
        """Make the ends."""
        self._place = str(section.options.get("place", "charger"))
        self._below = float(section.options.get("below", 0.2))
        self._sent, self._on, self._said = False, True, "the battery has not been heard of"
        self._host = host
        self._go_to = host.node.client("/navigation/go_to", "midspan_msgs/srv/Named")
        self._port = host.yarp.output("/charge/status:o")
        host.node.subscription("/battery_state", "sensor_msgs/msg/BatteryState", self._hear)
        host.yarp.respond("/charge/rpc", self._command)

    def health(self) -> Health:
        """What `midspan status` says of it."""
        return Health("running", self._said)

    def _hear(self, battery: dict[str, Any]) -> None:
        share = float(battery["percentage"])
        if share > self._below:
            self._sent = False
            self._say(f"{share:.0%} left")
        elif not self._on:
            self._say(f"{share:.0%} left; it is off")
        elif not self._sent:
            self._sent = True  # once for each time that it gets low: a person may have other plans
            self._say(f"{share:.0%} left: to {self._place}")
            self._go_to.call({"name": self._place}, self._answered)

    def _answered(self, reply: dict[str, Any] | CallError) -> None:
        failed = isinstance(reply, CallError)
        if failed or not reply["success"]:
            self._sent = False
            self._say(f"nobody drives to {self._place}: {reply if failed else reply['message']}")

    def _command(self, words: list[Any]) -> list[Any]:
        """What YARP programs say; it runs on the thread of their connection."""
        if words not in (["on"], ["off"]):
            raise ValueError("say on or off")
        self._host.loop.call(lambda: setattr(self, "_on", words == ["on"]))
        return ["[ok]"]

    def _say(self, text: str) -> None:
        self._said = text
        self._port.write([text])
