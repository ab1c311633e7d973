"""A module that republishes each message on the hub and on YARP."""

from __future__ import annotations

from typing import Any

from bridge.config.sections.modules import OwnModule
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.worker import Health


class Echo(Module):
    """Republishes messages from its subscription and input port on its publisher and output port."""

    name = "echo"

    def start(self, host: Host, section: OwnModule) -> None:
        if section.options.get("refuse"):
            msg = "start refused by its options"
            raise RuntimeError(msg)
        self.prefix = section.options.get("prefix", "")
        self.host = host
        self.received = 0
        self.out = host.node.publisher("/said", "std_msgs/msg/String")
        self.port = host.yarp.output(f"/{section.name}/said:o")
        host.node.subscription("/heard", "std_msgs/msg/String", self.on_message)
        host.yarp.respond(f"/{section.name}/rpc", lambda values: ["said", *values])
        host.yarp.input(f"/{section.name}/heard:i", lambda received: self.publish(str(received.values[0])))

    def on_message(self, message: dict[str, Any]) -> None:
        self.received += 1
        if message["data"] == "break":
            raise ValueError(message["data"])
        self.publish(message["data"])

    def publish(self, text: str) -> None:
        self.out.publish({"data": self.prefix + text})
        self.port.write([self.prefix + text])

    def reload(self, section: OwnModule) -> bool:
        if "restart" in section.options:
            return False
        self.prefix = section.options.get("prefix", "")
        return True

    def health(self) -> Health:
        return Health("running", f"heard {self.received}")

    def status(self) -> dict[str, Any]:
        return {"heard": self.received}


class NoModule:
    """A class that is not a module."""
