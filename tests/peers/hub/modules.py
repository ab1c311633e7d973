"""A hub with the worker of modules, and a place for a name server."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

from bridge.config.model import Config
from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from bridge.modules.worker import ModulesWorker
from tests.contract.hubside import HubSide
from tests.peers.hub.quick import QuickHub
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

STRING = "std_msgs/String"


class Place:
    """A hub, a worker, and a place for a name server."""

    def __init__(self, folder: Path) -> None:
        self.hubs = QuickHub()
        self.folder, self.port = folder, free_port()
        self.worker = ModulesWorker()
        self.far = HubSide(Hub.open(self.hubs.settings("far")), Registry())
        self.names = NameClient(Address("127.0.0.1", self.port), namespace="/root")

    def yarp_section(self, **more: Any) -> dict[str, Any]:
        """The section that leads to the name server."""
        return {"address": f"127.0.0.1:{self.port}", "namespace": "/root", "ip": "127.0.0.1", **more}

    def config(self, *own: dict[str, Any], **sections: Any) -> Config:
        return Config.model_validate({
            "name": "here",
            "state": self.folder,
            "hub": {"listen": self.hubs.endpoint},
            "yarp": self.yarp_section(),
            **sections,
            "modules": {"own": list(own), **sections.get("modules", {})},
        })  # fmt: skip

    def status(self, name: str) -> dict[str, Any] | None:
        answers = self.far.hub.ask("status", {}, worker=name)
        return next((a.value for a in answers if isinstance(a.value, dict)), None)

    def answer(self, name: str) -> dict[str, Any]:
        """The status of a module that runs; one that is busy may not answer at once."""
        result = until(lambda: self.status(name), f"{name} answers")
        assert result is not None
        return result

    def hears(self, said: str, heard: int, text: str) -> None:
        """Publish on ``/heard`` until the reply arrives."""
        out = self.far.advertise("/heard", STRING)

        def once() -> bool:
            self.far.publish(out, {"data": said})
            return text in {m["data"] for m in self.far.wait(heard, 1, 0.2)}

        until(once, f"{text} is heard")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.worker.stop()
        self.far.hub.close()
        self.hubs.stop_router()
