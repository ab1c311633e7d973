"""What YARP's clients of transforms call."""

# ruff: noqa: N802 - the methods' names are YARP's

from __future__ import annotations

from collections.abc import Callable

from bridge.tf.server.exchange import Exchange
from bridge.tf.server.view import ANY
from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.frametransformstorage import FrameTransformStorageGetRPC, FrameTransformStorageSetRPC
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnValue


class Setter(FrameTransformStorageSetRPC):
    """Takes transforms for the exchange.

    Args:
        exchange: where they go.
        changed: hears that something was set or deleted.
    """

    def __init__(self, exchange: Exchange, changed: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self._exchange, self._changed = exchange, changed

    def setTransformsRPC(self, transforms: list[FrameTransform]) -> ReturnValue:
        """Take several."""
        refusal = self._exchange.set(transforms)
        self._changed()
        if refusal is not None:
            raise CallFailed(reason=str(refusal))
        return OK

    def setTransformRPC(self, transform: FrameTransform) -> ReturnValue:
        """Take one."""
        return self.setTransformsRPC([transform])

    def deleteTransformRPC(self, src: str, dst: str) -> ReturnValue:
        """Forget what YARP programs set between two frames; as in YARP it fails where two named ones have nothing."""
        if not self._exchange.delete(src, dst) and ANY not in (src, dst):
            raise CallFailed(reason=f"no YARP program set anything between {src} and {dst}")
        self._changed()
        return OK

    def clearAllRPC(self) -> ReturnValue:
        """Forget all that YARP programs set."""
        return self.deleteTransformRPC(ANY, ANY)


class Getter(FrameTransformStorageGetRPC):
    """Gives what the exchange has."""

    def __init__(self, exchange: Exchange) -> None:
        super().__init__()
        self._exchange = exchange

    def getTransformsRPC(self) -> tuple[ReturnValue, list[FrameTransform]]:
        """All frames."""
        return OK, self._exchange.give()
