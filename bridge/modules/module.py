"""What a module is to the host that runs it, and the modules that come with Midspan."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

from bridge.config.sections.modules import OwnModule
from bridge.config.sections.section import Section
from bridge.worker import Health

if TYPE_CHECKING:
    from bridge.config.sections.section import Section
    from bridge.modules.host import Host


class Module(ABC):
    """A hosted node. It opens no socket and imports no middleware: its host hands it all ends.

    The host makes it anew for each start. Everything here is called on the module's own thread (`Host.loop`), as are
    the callbacks of its subscriptions, timers and hub servers; the methods that YARP clients call are not.
    """

    name: ClassVar[str]  #: its section's name in ``modules`` of the configuration, and its hub node's name

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

    def begin_stop(self, done: Callable[[], None]) -> None:
        """Wind down what must not end abruptly, such as a robot's motion, while all ends still work.

        ``done`` is called once, from any thread; the host waits for it for a short time before `stop`.
        """
        done()

    def stop(self) -> None:  # noqa: B027 - the host closes all ends that it gave
        """End what it began by itself; its ends are closed after it."""


KINDS: dict[str, str] = {
    "base_control": "navigation.base_control.module:BaseControl",
    "control_boards": "bridge.boards.module:ControlBoards",
    "gateway": "navigation.gateway.module:GatewayModule",
    "localization_server": "navigation.localization_server.module:LocalizationServer",
    "map2d_server": "navigation.map2d_server.module:Map2DServer",
    "mapper2d": "navigation.mapper2d.module:Mapper2D",
    "mapper3d": "navigation.mapper3d.module:Mapper3D",
    "robot_goto": "navigation.robot_goto.module:RobotGoto",
    "robot_path_planner": "navigation.robot_path_planner.module:RobotPathPlanner",
    "transform_server": "bridge.tf.server.module:TransformServer",
}
"""``package.module:Class`` of each module that comes with Midspan; imported in the process that runs it alone."""


def kind_of(name: str, section: Section) -> type[Module]:
    """A module's class; raises `RuntimeError` if it cannot be imported, or is none; the text says why."""
    factory = section.factory if isinstance(section, OwnModule) else KINDS[name]
    package, _, class_name = factory.partition(":")
    try:
        kind = getattr(importlib.import_module(package), class_name)
    except (ImportError, AttributeError) as err:
        raise RuntimeError(f"modules.{name}: {factory} cannot be imported: {err}") from None
    if not (isinstance(kind, type) and issubclass(kind, Module)):
        msg = f"modules.{name}: {factory} is no module: it does not derive from bridge.modules.module.Module"
        raise RuntimeError(msg)  # noqa: TRY004 - the configuration's fault, told as all of these are
    return kind
