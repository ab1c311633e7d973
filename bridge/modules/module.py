"""What a module is to the host that runs it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

from bridge.worker import Health

if TYPE_CHECKING:
    from bridge.config.sections.section import Section
    from bridge.modules.host import Host


class Module(ABC):
    """A hosted node. It opens no socket and imports no middleware: its host hands it all ends.

    The host makes it anew for each start. Everything here is called on the module's own thread (`Host.loop`), as are
    the callbacks of its subscriptions, timers and hub servers; the methods that YARP clients call are not.

    Attributes:
        name: its section's name in ``modules`` of the configuration, and its hub node's name.
    """

    name: ClassVar[str]

    @abstractmethod
    def start(self, host: Host, section: Section) -> None:
        """Make its endpoints and begin. Raises `RuntimeError` with a plain reason where it cannot."""

    def reload(self, section: Section) -> bool:  # noqa: ARG002 - most are quick to start
        """Take up another section while it runs; False where it is to be stopped and started with it."""
        return False

    def health(self) -> Health:
        """How it is, in a few words."""
        return Health("running", "")

    def status(self) -> dict[str, Any]:
        """What it tells of itself beyond its ends' counters, for the status document."""
        return {}

    def stop(self) -> None:  # noqa: B027 - the host closes all ends that it gave
        """End what it began by itself; its ends are closed after it."""
