"""The commands of both mappers on an RPC port; three of them are also services on the hub."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from typing_extensions import override

from bridge.modules.host import Host
from bridge.modules.services import Answer
from bridge.stores.entry import StoreError
from navigation.yarp import Commands
from yarp_compat.wire.errors import WireError

TRIGGER = "std_srvs/srv/Trigger"


class MappingCommands(Commands, ABC):
    """Commands of a mapper, among them ``start`` and ``stop``; errors of files and the store raise `ValueError` too."""

    @override
    def answer(self, values: list[Any]) -> list[Any]:
        try:
            return super().answer(values)
        except (OSError, StoreError, WireError) as err:
            raise ValueError(f"{values[0]}: {err}") from None

    @abstractmethod
    def save(self) -> str:
        """Save the map in the store; return a text for people. Raises `StoreError`, `OSError`, and `ValueError`."""

    def serve(self, host: Host, module: str) -> None:
        """Offer the services ``start``, ``stop`` and ``save`` under the module's name."""
        for command, done in (("start", "mapping"), ("stop", "not mapping")):
            host.node.server(f"/{module}/{command}", TRIGGER, self._trigger(command, done))
        host.node.server(f"/{module}/save", TRIGGER, self._save)

    def _trigger(self, command: str, done: str) -> Callable[[dict[str, Any], Answer], None]:
        def serve(_request: dict[str, Any], answer: Answer) -> None:
            self.answer([command])
            answer({"success": True, "message": done})

        return serve

    def _save(self, _request: dict[str, Any], answer: Answer) -> None:
        try:
            answer({"success": True, "message": self.save()})
        except (OSError, StoreError, ValueError) as err:  # an exception would leave clients on ROS 2 without a reply
            answer({"success": False, "message": str(err)})
