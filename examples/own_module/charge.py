"""A module that sends the robot to its charger when the battery is low, with any planner.

It subscribes to `/battery_state` (`sensor_msgs/BatteryState`), from any side, and sends goals to the gateway. YARP
programs read its state on `/charge/status:o`, and switch it `on` or `off` at `/charge/rpc`.
"""

from __future__ import annotations

from typing import Any

from bridge.hub.endpoints.calls import CallError
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.worker import Health


class Charge(Module):
    """Options: ``place``, the charger's location; ``below``, the charge (0 to 1) below which the battery is low."""

    name = "charge"

    def start(self, host: Host, section: Any) -> None:
        """Open the topics, the service client and the YARP ports."""
        self._place = str(section.options.get("place", "charger"))
        self._below = float(section.options.get("below", 0.2))
        self._sent, self._on, self._text = False, True, "waiting for the battery's state"
        self._host = host
        self._go_to = host.node.client("/navigation/go_to", "midspan_msgs/srv/Named")
        self._port = host.yarp.output("/charge/status:o")
        host.node.subscription("/battery_state", "sensor_msgs/msg/BatteryState", self._on_battery)
        host.yarp.respond("/charge/rpc", self._command)

    def health(self) -> Health:
        """Return the state that `midspan status` shows."""
        return Health("running", self._text)

    def _on_battery(self, battery: dict[str, Any]) -> None:
        share = float(battery["percentage"])
        if share > self._below:
            self._sent = False
            self._report(f"{share:.0%} left")
        elif not self._on:
            self._report(f"{share:.0%} left; off")
        elif not self._sent:
            self._sent = True  # only once per discharge, because an operator may send the robot elsewhere
            self._report(f"{share:.0%} left: to {self._place}")
            self._go_to.call({"name": self._place}, self._answered)

    def _answered(self, reply: dict[str, Any] | CallError) -> None:
        failed = isinstance(reply, CallError)
        if failed or not reply["success"]:
            self._sent = False
            self._report(f"cannot drive to {self._place}: {reply if failed else reply['message']}")

    def _command(self, words: list[Any]) -> list[Any]:
        """Handle a request to the RPC port, on the thread of its connection."""
        if words not in (["on"], ["off"]):
            raise ValueError("the commands are on and off")
        self._host.loop.call(lambda: setattr(self, "_on", words == ["on"]))
        return ["[ok]"]

    def _report(self, text: str) -> None:
        self._text = text
        self._port.write([text])
