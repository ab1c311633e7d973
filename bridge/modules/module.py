"""The interface between a module and its host."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, ClassVar

from bridge.config.sections.modules import OwnModule
from bridge.config.sections.section import Section
from bridge.descriptors import all_modules
from bridge.registration import imported
from bridge.status import Part
from bridge.worker import Health

if TYPE_CHECKING:
    from bridge.modules.host import Host


class Module(ABC):
    """A hosted node. It opens no socket and imports no middleware, because its host provides all endpoints.

    The host creates a new instance for each start. It calls all methods below on the module's own thread (`Host.loop`),
    which also runs the callbacks of subscriptions, timers and hub servers, but not the methods that YARP clients call.
    """

    name: ClassVar[str]  #: key of the module's section under ``modules`` in the configuration, and name of its hub node

    @abstractmethod
    def start(self, host: Host, section: Section) -> None:
        """Create the endpoints and start; raises `RuntimeError` with a readable reason if that is impossible."""

    def reload(self, section: Section) -> bool:  # noqa: ARG002 - most modules restart quickly
        """Apply a new section while running; return False to be restarted with that section instead."""
        return False

    def health(self) -> Health:
        """Return the module's state, with a few words of detail."""
        return Health("running", "")

    def status(self) -> Part:
        """Return the module's own keys for the status document; keys that other programs read have fields."""
        return Part()

    def warnings(self) -> Iterable[str]:
        """Return problems that users should fix although the module runs, for status and doctor; "" is ignored."""
        return ()

    def on_failure(self, error: BaseException) -> bool:  # noqa: ARG002 - most modules need nothing else
        """Handle an error that a callback or a background job of the module raised, after it was logged.

        Return False to have the host cancel and abort the active goals of the module's actions.
        """
        return False

    def begin_stop(self, done: Callable[[], None]) -> None:
        """Begin to stop what must not end abruptly, such as a robot's motion, while all endpoints still work.

        Call ``done`` once, from any thread; the host waits briefly for that before it calls `stop`.
        """
        done()

    def stop(self) -> None:  # noqa: B027 - the host closes all endpoints that it created
        """Release what the module itself acquired; the host closes the endpoints afterwards."""


def kind_of(name: str, section: Section) -> type[Module]:
    """Return a module's class; raises `RuntimeError` if the import fails or the object is not a module class."""
    factory = section.factory if isinstance(section, OwnModule) else all_modules()[name].factory
    return imported_class(f"modules.{name}", factory, Module)


def imported_class(key: str, factory: str, base: type[Any]) -> type[Any]:
    """Return the class ``package.module:Class`` that the configuration names at ``key``.

    Raises `RuntimeError` if the import fails, or the object is not a class derived from ``base``.
    """
    try:
        kind = imported(factory)
    except (ImportError, AttributeError) as err:
        raise RuntimeError(f"{key}: {factory} cannot be imported: {err}") from None
    if not (isinstance(kind, type) and issubclass(kind, base)):
        msg = f"{key}: {factory} is not a subclass of {base.__module__}.{base.__name__}"
        raise RuntimeError(msg)  # noqa: TRY004 - a configuration error, reported like the others
    return kind
