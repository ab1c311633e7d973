"""The ports for YARP's transform clients: the RPC ports that they call, and the port that streams all frames."""

from __future__ import annotations

import time
from collections.abc import Callable

from typing_extensions import override

from bridge.modules.ports import HostedPort
from bridge.transform_server.exchange import Exchange
from bridge.transform_server.view import ANY
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
    """Passes on to the exchange the transforms that clients set.

    Args:
        changed: called after something was set or deleted.
    """

    def __init__(self, exchange: Exchange, changed: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self._exchange, self._changed = exchange, changed

    @override
    def setTransformsRPC(self, transforms: list[FrameTransform]) -> ReturnValue:
        refusal = self._exchange.set(transforms)
        self._changed()
        if refusal is not None:
            raise CallFailed(reason=str(refusal))
        return OK

    @override
    def setTransformRPC(self, transform: FrameTransform) -> ReturnValue:
        return self.setTransformsRPC([transform])

    @override
    def deleteTransformRPC(self, src: str, dst: str) -> ReturnValue:
        """Delete the transforms between two frames, if YARP programs have set them; those of other sides stay.

        As in YARP, this fails if the transform does not exist, unless one of the frames is `*`.
        """
        if not self._exchange.delete(src, dst) and ANY not in (src, dst):
            raise CallFailed(reason=f"no YARP program has set a transform between {src} and {dst}")
        self._changed()
        return OK

    @override
    def clearAllRPC(self) -> ReturnValue:
        return self.deleteTransformRPC(ANY, ANY)


class Getter(FrameTransformStorageGetRPC):
    """Returns the exchange's frames."""

    def __init__(self, exchange: Exchange) -> None:
        super().__init__()
        self._exchange = exchange

    @override
    def getTransformsRPC(self) -> tuple[ReturnValue, list[FrameTransform]]:
        return OK, self._exchange.frames()


_SOON = 0.2
"""When a YARP program sets frames, everything is sent if this fraction of the period has passed since the last time. A
client that sets frames at the stream's rate therefore sets the pace, so hardly any are skipped when it is late."""

_DUE = 0.9  # a tick sends everything if this fraction has passed; otherwise a change has just done so


class FrameStream:
    """The port that streams all frames. Used only on the module's thread."""

    def __init__(
        self,
        port: HostedPort,
        frames: Callable[[], list[FrameTransform]],
        generation: Callable[[Profile], Generation],  # the generation to assume for a reader of this dialect
        period: float,
    ) -> None:
        self._port, self._frames, self._generation, self._period = port, frames, generation, period
        self._last = 0.0

    def tick(self) -> None:
        """Send all frames, unless they were just sent; called once per period."""
        self._send(_DUE)

    def changed(self) -> None:
        """Send all frames because a YARP program has set some, unless they were sent very recently."""
        self._send(_SOON)

    def _send(self, part: float) -> None:
        now = time.monotonic()
        if self._port.has_readers and now - self._last >= part * self._period:
            self._last = now
            self._port.write(_All(self._frames(), self._generation))


class _All(AllTransforms):
    """All frames, with the outcome in the form that the reader's YARP generation expects."""

    def __init__(self, transforms: list[FrameTransform], generation: Callable[[Profile], Generation]) -> None:
        super().__init__(OK, transforms)
        self._generation = generation

    @override
    def to_wire(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> list[Buffer]:
        return super().to_wire(profile, generation or self._generation(profile))
