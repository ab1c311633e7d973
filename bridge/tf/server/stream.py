"""What is streamed to YARP's clients of transforms: all frames, over and over."""

from __future__ import annotations

import time
from collections.abc import Callable

from bridge.modules.ports import HostedPort
from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.frametransformstorage import Transforms
from yarp_compat.dev.returnvalue import OK
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile

_SOON = 0.2
"""Part of the period after which what a YARP program sets is sent at once: a client that sets as often as the stream
sends is then heard in step, and hardly anything that it says is skipped, also where it is late now and then."""

_DUE = 0.9
"""Part of the period after which the rest is sent, so that both together do not send twice."""


class Stream:
    """The streaming port. Used on the module's thread.

    Args:
        port: where to.
        give: all frames as of now.
        generation: the release of the programs of a dialect.
        period: seconds between two messages.
    """

    def __init__(
        self,
        port: HostedPort,
        give: Callable[[], list[FrameTransform]],
        generation: Callable[[Profile], Generation],
        period: float,
    ) -> None:
        self._port, self._give, self._generation, self._period = port, give, generation, period
        self._last = 0.0

    def tick(self) -> None:
        """Send what holds now; called every period."""
        self._send(_DUE)

    def changed(self) -> None:
        """A YARP program has set something."""
        self._send(_SOON)

    def _send(self, part: float) -> None:
        now = time.monotonic()
        if self._port.heard and now - self._last >= part * self._period:
            self._last = now
            self._port.write(_All(self._give(), self._generation))


class _All(Transforms):
    """All frames, with the outcome as each generation of YARP reads it."""

    def __init__(self, transforms: list[FrameTransform], generation: Callable[[Profile], Generation]) -> None:
        super().__init__(OK, transforms)
        self._generation = generation

    def to_wire(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> list[Buffer]:
        """The bytes for a dialect."""
        return super().to_wire(profile, generation or self._generation(profile))
