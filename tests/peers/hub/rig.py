"""A hub with a router in the test's process, a native program on it, and objects that are stopped with the hub."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any, Self

from bridge.config.model import Config
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.peers.hub.quick import QuickHub
from tests.support.wait import until


class HubRig:
    """A hub, and the sessions and workers on it.

    Args:
        folder: for the state of daemons.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.hubs = QuickHub()
        self._open: list[Any] = []

    @cached_property
    def far(self) -> HubSide:
        """A native program on the hub."""
        return HubSide(Hub.open(self.hubs.settings("far")), Registry())

    def config(self, **sections: Any) -> Config:
        """Return the configuration of a daemon on this hub."""
        hub = {"listen": self.hubs.endpoint}
        return Config.model_validate({"name": "here", "state": self.folder, "hub": hub, **sections})

    def keep(self, thing: Any) -> Any:
        """Register an object to be stopped with the rig, before those that were started earlier; return it."""
        self._open.append(thing)
        return thing

    def status(self, worker: str) -> dict[str, Any] | None:
        """Return a worker's status document, or None if the worker does not respond."""
        answers = self.far.hub.ask("status", {}, worker=worker)
        return next((a.value for a in answers if isinstance(a.value, dict)), None)

    def answer(self, worker: str) -> dict[str, Any]:
        """Wait for a worker's status document, because a busy worker may not respond at once."""
        status: dict[str, Any] = until(lambda: self.status(worker), f"{worker} reports its status")
        return status

    def close(self) -> None:
        """Stop everything, the hub last."""
        for thing in reversed(self._open):
            thing.stop()
        if "far" in self.__dict__:
            self.far.hub.close()
        self.hubs.stop_router()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
