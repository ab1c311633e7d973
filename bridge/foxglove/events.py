"""What clients do, from the SDK's threads to the worker's: as state that grows with what clients have open, no further.

The SDK calls on the threads that also send (its ``ServerListener``), so that nothing here waits.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from threading import Lock
from typing import Protocol

from foxglove import Parameter
from foxglove.websocket import ChannelView, Client, ClientChannel, ServerListener

from bridge.foxglove.visitors import MARK, Visitors

MOST_ADVERTISED = 100
"""Channels that one client advertises; those beyond are left out."""
MOST_WAITING = 256
MOST_BYTES = 64 << 20
"""Messages of clients that wait for the worker's thread, and their bytes; the oldest make room."""


@dataclass(frozen=True, slots=True, eq=False)
class Advertised:
    """A channel that a client advertises; ``number`` is its own."""

    client: int
    number: int
    topic: str
    encoding: str
    type_name: str


@dataclass(frozen=True, slots=True)
class ClientMessage:
    """A message of a client, and when it came (monotonic seconds)."""

    channel: Advertised
    data: bytes
    arrived: float


class AnswersParameters(Protocol):
    """`bridge.foxglove.parameters.Parameters`; called on the SDK's threads."""

    def answer(self, names: Sequence[str]) -> list[Parameter]:
        """Values of these, or of all."""

    def change(self, client: int, wanted: Sequence[Parameter]) -> list[Parameter]:
        """Values afterwards."""


class Events(ServerListener):
    """The SDK's listener.

    Args:
        visitors: is told of clients that come and go.
        changed: called on the SDK's threads after a change, once until `take` was called.
    """

    def __init__(self, visitors: Visitors, changed: Callable[[], None]) -> None:
        self._visitors, self._changed = visitors, changed
        self._lock = Lock()
        self._notified = False
        self._watched: dict[int, set[int]] = {}
        self._late: set[int] = set()
        self._advertised: dict[tuple[int, int], Advertised] = {}
        self._count = Counter[int]()
        self._messages: deque[ClientMessage] = deque()
        self._size = 0
        self.dropped = 0  # messages of clients that found no room
        self.parameters: AnswersParameters | None = None

    # -- what clients watch --------------------------------------------------------------------------------------------

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """A client wants a channel."""
        with self._lock:
            self._watched.setdefault(channel.id, set()).add(client.id)
            self._late.add(channel.id)
            self._notify()

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """A client no longer wants a channel, or is gone, or the channel is."""
        with self._lock:
            clients = self._watched.get(channel.id, set())
            clients.discard(client.id)
            if not clients:
                self._watched.pop(channel.id, None)
                self._late.discard(channel.id)
            self._notify()

    def pop_watched(self) -> tuple[set[int], set[int]]:
        """The channels that are watched, and those of them that somebody began to watch since the last call."""
        with self._lock:
            self._notified = False
            late, self._late = self._late, set()
            return set(self._watched), late

    # -- what clients ask ----------------------------------------------------------------------------------------------

    def on_get_parameters(
        self,
        client: Client,  # noqa: ARG002 - everybody may look
        param_names: list[str],
        request_id: str | None = None,  # noqa: ARG002 - the SDK answers with it
    ) -> list[Parameter]:
        """A client asks for parameters, for all where it names none."""
        return self.parameters.answer(param_names) if self.parameters else []

    def on_set_parameters(
        self,
        client: Client,
        parameters: list[Parameter],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        """A client sets parameters; what they are then, which the SDK tells all who subscribed to them."""
        return self.parameters.change(client.id, parameters) if self.parameters else []

    # -- what clients say ----------------------------------------------------------------------------------------------

    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        """A client is going to publish; or the front tells who it is."""
        if channel.id == MARK:
            self._visitors.identify(client.id, channel.topic)
            return
        advertised = Advertised(client.id, channel.id, channel.topic, channel.encoding, channel.schema_name)
        with self._lock:
            if self._count[client.id] < MOST_ADVERTISED:
                self._advertised[client.id, channel.id] = advertised
                self._count[client.id] += 1
                self._notify()

    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        """A client publishes no more, or is gone."""
        if client_channel_id == MARK:
            self._visitors.remove_client(client.id)
            return
        with self._lock:
            if self._advertised.pop((client.id, client_channel_id), None) is not None:
                self._count[client.id] -= 1
                self._count += Counter()  # without those of none
                self._notify()

    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        """A client publishes."""
        with self._lock:
            channel = self._advertised.get((client.id, client_channel_id))
            if channel is None:
                return
            self._messages.append(ClientMessage(channel, data, time.monotonic()))
            self._size += len(data)
            while len(self._messages) > MOST_WAITING or (self._size > MOST_BYTES and len(self._messages) > 1):
                self._size -= len(self._messages.popleft().data)
                self.dropped += 1
            self._notify()

    def pop_published(self) -> tuple[Mapping[tuple[int, int], Advertised], list[ClientMessage]]:
        """What is advertised now, and what was published since the last call."""
        with self._lock:
            messages, self._messages, self._size = list(self._messages), deque(), 0
            return dict(self._advertised), messages

    def _notify(self) -> None:
        if not self._notified:
            self._notified = True
            self._changed()
