"""What YARP's clients of transforms call, and what is streamed to them."""

# ruff: noqa: N802 - the methods' names are YARP's

from __future__ import annotations

from collections.abc import Callable

from bridge.tf.server.exchange import Exchange
from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.frametransformstorage import (
    FrameTransformStorageGetRPC,
    FrameTransformStorageSetRPC,
    Transforms,
)
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnValue
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile


class Setter(FrameTransformStorageSetRPC):
    """Takes transforms for the exchange."""

    def __init__(self, exchange: Exchange) -> None:
        super().__init__()
        self._exchange = exchange

    def setTransformsRPC(self, transforms: list[FrameTransform]) -> ReturnValue:
        """Take several."""
        refusal = self._exchange.set(transforms)
        if refusal is not None:
            raise CallFailed(reason=str(refusal))
        return OK

    def setTransformRPC(self, transform: FrameTransform) -> ReturnValue:
        """Take one."""
        return self.setTransformsRPC([transform])

    def deleteTransformRPC(self, src: str, dst: str) -> ReturnValue:
        """Forget what YARP programs set between two frames; as in YARP it fails where two named ones have nothing."""
        if not self._exchange.delete(src, dst) and "*" not in (src, dst):
            raise CallFailed(reason=f"no YARP program set anything between {src} and {dst}")
        return OK

    def clearAllRPC(self) -> ReturnValue:
        """Forget all that YARP programs set."""
        self._exchange.delete("*", "*")
        return OK


class Getter(FrameTransformStorageGetRPC):
    """Gives what the exchange has."""

    def __init__(self, exchange: Exchange) -> None:
        super().__init__()
        self._exchange = exchange

    def getTransformsRPC(self) -> tuple[ReturnValue, list[FrameTransform]]:
        """All frames."""
        return OK, self._exchange.give()


class Streamed(Transforms):
    """All frames, each generation of YARP with the outcome as it reads it.

    Args:
        transforms: the frames.
        generation: the one of the programs of a dialect.
    """

    def __init__(self, transforms: list[FrameTransform], generation: Callable[[Profile], Generation]) -> None:
        super().__init__(OK, transforms)
        self._generation = generation

    def to_wire(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> list[Buffer]:
        """The bytes for a dialect."""
        return super().to_wire(profile, generation or self._generation(profile))
