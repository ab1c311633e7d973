"""What a server streams, typed and with its time: positions of ``<localization server>/streaming:o``, for example.

with Stream("/localization2D_nws_yarp/streaming:o", Map2DLocation) as positions:
    for position, stamp in positions: ...
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Generic, Self, TypeVar

from yarp_compat.naming import connections
from yarp_compat.naming.naming import Naming
from yarp_compat.os.stamp import Stamp
from yarp_compat.pythonic import Reader, Received
from yarp_compat.wire.portable import Portable

T = TypeVar("T", bound=Portable)


class Stream(Generic[T]):
    """Hears a port that writes one kind of data, between ``with`` and its end.

    A position whose coordinates are no numbers is that of a robot which does not know where it is.

    Args:
        source: the port; ``udp://robot/odometry:o`` says the carrier too.
        kind: `Map2DLocation`, `OdometryData`, `Bottle` for the text of a ``status:o``, ...
        name: the own port's name; empty lets the name server choose one.
        strict: give every message; by default the newest one only.
        naming: who knows the names; by default the name server of ``yarp.conf``.
    """

    def __init__(
        self, source: str, kind: type[T], name: str = "", *, strict: bool = False, naming: Naming | None = None
    ) -> None:
        self._source, self._kind = source, kind
        self._reader = Reader(name, strict=strict, naming=naming)

    def open(self) -> Self:
        """Open the port and connect the source to it.

        Raises:
            NamingError: there is no name server.
            PortError: there is no such port.
        """
        self._reader.open()
        try:
            connections.connect(self._reader.core.naming, self._source, self._reader.name)
        except BaseException:
            self.close()
            raise
        return self

    def close(self) -> None:
        """Close the port; who iterates comes to the end."""
        self._reader.close()

    def read(self) -> tuple[T, float] | None:
        """Wait for the next message: the data, and its time in seconds, 0 where it has none. None once this is closed.

        Raises:
            WireError: it is something else.
        """
        return self._taken(self._reader.read())

    def read_now(self) -> tuple[T, float] | None:
        """The next message, if there is one."""
        return self._taken(self._reader.read_now())

    def __iter__(self) -> Iterator[tuple[T, float]]:
        while (taken := self.read()) is not None:
            yield taken

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _taken(self, received: Received | None) -> tuple[T, float] | None:
        if received is None:
            return None
        stamp = Stamp()
        if received.envelope:
            stamp.from_text(received.envelope)
        return received.to(self._kind), stamp.getTime()
