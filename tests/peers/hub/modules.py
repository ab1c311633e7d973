"""A hub with the modules' worker, and an address for a name server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bridge.config.model import Config
from bridge.modules.worker import ModulesWorker
from tests.peers.hub.rig import HubRig
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

STRING = "std_msgs/String"


class Place(HubRig):
    """A hub, a worker, and an address for a name server."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.port = free_port()
        self.worker = self.keep(ModulesWorker())
        self.names = NameClient(Address("127.0.0.1", self.port), namespace="/root")

    def yarp_section(self, **more: Any) -> dict[str, Any]:
        """Return the configuration section that names the name server."""
        return {"address": f"127.0.0.1:{self.port}", "namespace": "/root", "ip": "127.0.0.1", **more}

    def config(self, *own: dict[str, Any], **sections: Any) -> Config:
        """Return a configuration with these modules."""
        modules = {"own": list(own), **sections.pop("modules", {})}
        return super().config(**{"yarp": self.yarp_section(), **sections, "modules": modules})

    def until_replied(self, sent: str, subscription: int, text: str) -> None:
        """Publish to the module until a subscription receives its reply."""
        out = self.far.advertise("/heard", STRING)

        def once() -> bool:
            self.far.publish(out, {"data": sent})
            return text in {m["data"] for m in self.far.wait(subscription, 1, 0.2)}

        until(once, f"{text} arrives")
