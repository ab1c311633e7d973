"""Clients of a device server: calls through an RPC port, and subscriptions to its stream.

If the server has restarted, the RPC port reconnects before a call, and the stream on its own thread.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from typing import Generic, Self, TypedDict, TypeVar, Unpack

from yarp_compat.dev.service import Service
from yarp_compat.naming import connections
from yarp_compat.os.data.stamp import Stamp
from yarp_compat.overriding import override
from yarp_compat.ports.naming import Naming, PortError
from yarp_compat.ports.outgoing import Content
from yarp_compat.ports.port import PortCore
from yarp_compat.ports.sockets import Openable, closed_on_failure
from yarp_compat.pythonic import Client, Reader, Received
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.reply import ReplyEnd

S = TypeVar("S", bound=Service)

log = logging.getLogger(__name__)

PATIENCE = 10.0  # seconds to wait for a reply by default


class PortChannel:
    """Sends requests through a port that is connected to the server's port over a binary carrier.

    ``generation`` is assumed for the server until a reply shows another. ``connect`` reconnects the port before a call;
    a call in progress is never repeated.
    """

    def __init__(
        self, port: PortCore, generation: Generation = Generation.YARP_3_12, timeout: float | None = None,
        connect: Callable[[], object] | None = None,
    ) -> None:  # fmt: skip
        self._connect = connect
        self._connecting = threading.RLock()  # a second connection would close the first, with its pending call
        self._generation = generation
        self._is_fixed = False
        self._port = port
        self._timeout = timeout

    @property
    def generation(self) -> Generation:
        """The server's generation, which its replies set."""
        profile = self._port.answers_in
        if not self._is_fixed and profile is not None and profile is not self._generation.profile:
            self._generation = Generation.newest(profile)
        return self._generation

    @generation.setter
    def generation(self, generation: Generation) -> None:
        self._generation, self._is_fixed = generation, True

    def request(self, payload: Content, parse: ReplyEnd | None) -> Buffer:
        """Send a request and return the reply; raises `TimeoutError`, or `ConnectionError` if not connected.

        ``parse`` finds the reply's end; None: the reply is a Bottle.
        """
        if self._connect is not None and self._port.is_open and not self._port.connections.outputs:
            with self._connecting:
                try:
                    if not self._port.connections.outputs:
                        self._connect()
                except PortError as error:
                    raise ConnectionRefusedError(str(error)) from error
        return self._port.request(payload, timeout=self._timeout, parse=parse)


_RECONNECT_SECONDS = 0.5  # between attempts to reconnect a stream
_END_SECONDS = 0.5  # to wait for an attempt when a stream closes; one to an absent machine takes longer


class StreamReader(Reader):
    """A reader that connects its source to itself, and again after the connection has ended.

    A lost connection over udp or mcast is not detected. For the arguments, see `Stream`.
    """

    def __init__(
        self, source: str, name: str = "", carrier: str = "", *, strict: bool = False, naming: Naming | None = None
    ) -> None:
        self._wake = threading.Event()
        super().__init__(name, strict=strict, naming=naming, on_event=lambda _event: self._wake.set())
        self._source, self._carrier = source, carrier
        self._thread: threading.Thread | None = None

    @override
    def open(self) -> Self:
        """Open the port and connect the source to it; raises `NamingError`, or `PortError` if the source is missing."""
        if self.core.is_open:
            return self
        super().open()
        with closed_on_failure(self):
            self._connect()
            thread = threading.Thread(target=self._run, name=f"yarp stream {self._source}", daemon=True)
            thread.start()
            self._thread = thread
        return self

    @override
    def close(self) -> None:
        """Close the port, which ends iterations."""
        super().close()
        self._wake.set()
        if self._thread is not None:
            self._thread.join(_END_SECONDS)

    def _connect(self) -> None:
        connections.connect(self.core.naming, self._source, self.name, self._carrier)

    def _run(self) -> None:
        missing = False
        while True:
            self._wake.wait(_RECONNECT_SECONDS if missing else None)
            self._wake.clear()
            if not self.core.is_open:
                return
            # another source may have replaced it (``yarp connect``, ``yarp disconnect``): two would be mixed
            missing = not self.core.connections.inputs
            if missing:
                try:
                    self._connect()
                except OSError:  # the source may return later
                    pass
                except Exception:  # without this thread, the stream would end for good
                    log.exception("reconnecting the stream of %s failed", self._source)


T = TypeVar("T", bound=Portable)


class Stream(Openable, Generic[T]):
    """Reads a port that writes one ``kind`` of data, such as `Map2DLocation`, inside a ``with`` block.

    NaN coordinates of a `Map2DLocation` mean that the robot is not localized. The source may include the carrier,
    ``udp://robot/odometry:o``; else ``carrier`` selects it. ``strict``: read every message, not only the newest. For
    the other arguments, see `OpenPort`. If the source restarts, the stream continues; see `StreamReader`.
    """

    def __init__(
        self, source: str, kind: type[T], name: str = "", carrier: str = "", *, strict: bool = False,
        naming: Naming | None = None,
    ) -> None:  # fmt: skip
        self._kind = kind
        self._reader = StreamReader(source, name, carrier, strict=strict, naming=naming)

    @override
    def open(self) -> Self:
        """Open the port and connect the source to it; raises like `StreamReader.open`."""
        self._reader.open()
        return self

    @override
    def close(self) -> None:
        self._reader.close()

    def read(self) -> tuple[T, float] | None:
        """Wait for the next data and its time in seconds (0: none); None once closed. Raises `WireError`."""
        return self._decoded(self._reader.read())

    def read_now(self) -> tuple[T, float] | None:
        """Return the next message without waiting, or None."""
        return self._decoded(self._reader.read_now())

    def __iter__(self) -> Iterator[tuple[T, float]]:
        while (decoded := self.read()) is not None:
            yield decoded

    def _decoded(self, received: Received | None) -> tuple[T, float] | None:
        if received is None:
            return None
        stamp = Stamp()
        if received.envelope:
            stamp.from_text(received.envelope)
        return received.to(self._kind), stamp.getTime()


class ClientOptions(TypedDict, total=False):
    """``timeout`` in seconds for a reply (None: no limit; default `PATIENCE`); ``naming`` (default ``yarp.conf``)."""

    timeout: float | None
    naming: Naming | None


class ServiceClient(Client, Generic[S]):
    """A client of a server's methods: ``client.remote.get_map_names_RPC()``; for the options, see `ClientOptions`.

    ``server`` is the server's port, or carrier and port as in ``fast_tcp://map2D_nws_yarp/rpc``; ``name`` is the
    client's own port; if it is empty, the name server chooses one.
    """

    def __init__(self, interface: type[S], server: str, name: str = "", **options: Unpack[ClientOptions]) -> None:
        super().__init__(server, name, naming=options.get("naming"))
        timeout = options.get("timeout", PATIENCE)
        self._channel = PortChannel(self.core, timeout=timeout, connect=self._reconnect)
        self.remote = interface(self._channel)
        self.version: tuple[int, int, int, int] | None = None  # from `Service.introduce`, at `open`

    @property
    def generation(self) -> Generation:
        """The server's generation of YARP."""
        return self._channel.generation

    def _reconnect(self) -> None:
        """Reconnect and introduce the client again, because servers store a client's release per connection."""
        self.connect(self.server)
        self.version = self.remote.introduce()

    @override
    def open(self) -> Self:
        """Open the port, connect it, and introduce it, as YARP 4's servers expect; raises like `StreamReader.open`."""
        super().open()
        with closed_on_failure(self):
            self.version = self.remote.introduce()
        return self


class StreamingClient(ServiceClient[S], Generic[S, T]):
    """A client of a server that also streams one ``kind`` of data.

    ``source`` is the streaming port, ``reader`` the client's port that receives the stream over ``carrier``.
    """

    def __init__(
        self, interface: type[S], server: str, name: str, source: str, kind: type[T], reader: str, carrier: str,
        **options: Unpack[ClientOptions],
    ) -> None:  # fmt: skip
        super().__init__(interface, server, name, **options)
        self._stream = Stream(source, kind, reader, carrier, naming=options.get("naming"))
        self._last: tuple[T, float] | None = None

    @override
    def open(self) -> Self:
        """Open both ports and connect them; raises like `ServiceClient.open`."""
        super().open()
        with closed_on_failure(self):
            self._stream.open()
        return self

    @override
    def close(self) -> None:
        """Close both ports, which ends pending `read` calls."""
        self._stream.close()
        super().close()

    def read(self) -> tuple[T, float] | None:
        """Wait for the next data and its time stamp in seconds; None once the stream is closed."""
        received = self._converted(self._stream.read())
        self._last = received or self._last
        return received

    def last(self) -> tuple[T, float] | None:
        """Return the newest data (skipping other types) and its time stamp in seconds; None before the first."""
        with contextlib.suppress(WireError):
            self._last = self._converted(self._stream.read_now()) or self._last
        return self._last

    def _converted(self, received: tuple[T, float] | None) -> tuple[T, float] | None:
        """Convert data that a server of an older release has sent; by default return it unchanged."""
        return received
