"""The ports for YARP's clients of transforms: the RPC ports that they call, and the stream of all frames."""

# ruff: noqa: N802 - the methods' names are YARP's

from __future__ import annotations

import time
from collections.abc import Callable

from bridge.modules.ports import HostedPort
from bridge.tf.server.exchange import Exchange
from bridge.tf.server.view import ANY
from yarp_compat.dev.frametransform import (
    AllTransforms,
    FrameTransform,
    FrameTransformStorageGetRPC,
    FrameTransformStorageSetRPC,
)
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnValue
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.profile import Profile


class Setter(FrameTransformStorageSetRPC):
    """Takes transforms for the exchange.

    Args:
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
    """Gives the exchange's frames."""

    def __init__(self, exchange: Exchange) -> None:
        super().__init__()
        self._exchange = exchange

    def getTransformsRPC(self) -> tuple[ReturnValue, list[FrameTransform]]:
        """All frames."""
        return OK, self._exchange.frames()


_SOON = 0.2
"""Part of the period after which what a YARP program sets is sent at once: a client that sets as often as the stream
sends is then heard in step, and hardly anything that it says is skipped, also where it is late now and then."""

_DUE = 0.9  # part of the period after which the rest is sent, so that both together do not send twice


class FrameStream:
    """The streaming port. Used on the module's thread."""

    def __init__(
        self,
        port: HostedPort,
        frames: Callable[[], list[FrameTransform]],
        generation: Callable[[Profile], Generation],  # the release of the programs of a dialect
        period: float,
    ) -> None:
        self._port, self._frames, self._generation, self._period = port, frames, generation, period
        self._last = 0.0

    def tick(self) -> None:
        """Send all frames; called every period."""
        self._send(_DUE)

    def changed(self) -> None:
        """A YARP program has set something."""
        self._send(_SOON)

    def _send(self, part: float) -> None:
        now = time.monotonic()
        if self._port.has_readers and now - self._last >= part * self._period:
            self._last = now
            self._port.write(_All(self._frames(), self._generation))


class _All(AllTransforms):
    """All frames, with the outcome as each generation of YARP reads it."""

    def __init__(self, transforms: list[FrameTransform], generation: Callable[[Profile], Generation]) -> None:
        super().__init__(OK, transforms)
        self._generation = generation

    def to_wire(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> list[Buffer]:
        """The bytes for a dialect."""
        return super().to_wire(profile, generation or self._generation(profile))
