"""Passes clients' requests from the SDK's threads to the worker's thread.

The state is bounded: the channels of each client, and the number and the bytes of waiting messages. The SDK calls its
``ServerListener`` on the threads that also send, so these methods must not block.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from threading import Lock
from typing import Protocol

from foxglove import Parameter
from foxglove.websocket import ChannelView, Client, ClientChannel, ServerListener
from typing_extensions import override

from bridge.clock import steady
from bridge.foxglove.visitors import MARK, Visitors

MOST_ADVERTISED = 100
"""Maximum number of channels of one client; further ones are ignored."""
MOST_WAITING = 256
MOST_BYTES = 64 << 20
"""Limits on the number and the bytes of all clients' messages that wait for the worker's thread.

If a limit is exceeded, the oldest messages are dropped; a single message may have more bytes.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Advertised:
    """A channel that a client advertises; ``number`` is the client's id for it."""

    client: int
    number: int
    topic: str
    encoding: str
    type_name: str


@dataclass(frozen=True, slots=True)
class ClientMessage:
    """A message of a client, with its time of arrival (seconds of `steady`)."""

    channel: Advertised
    data: bytes
    arrived: float


class AnswersParameters(Protocol):
    """`bridge.foxglove.parameters.Parameters`; called on the SDK's threads."""

    def answer(self, names: Sequence[str]) -> list[Parameter]:
        """Return the values of these parameters, or of all if ``names`` is empty."""

    def change(self, client: int, wanted: Sequence[Parameter]) -> list[Parameter]:
        """Set parameters, and return their values afterwards."""


class Events(ServerListener):
    """Receives the SDK's events.

    Args:
        visitors: registry of the clients, which `Events` updates.
        changed: called on the SDK's threads after a change, but not again before the next `pop_watched`.
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
        self.dropped = 0  # number of clients' messages that were dropped because the queue was full
        self.parameters: AnswersParameters | None = None

    # -- what clients watch --------------------------------------------------------------------------------------------

    @override
    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        with self._lock:
            self._watched.setdefault(channel.id, set()).add(client.id)
            self._late.add(channel.id)
            self._notify()

    @override
    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        with self._lock:
            clients = self._watched.get(channel.id, set())
            clients.discard(client.id)
            if not clients:
                self._watched.pop(channel.id, None)
                self._late.discard(channel.id)
            self._notify()

    def pop_watched(self) -> tuple[set[int], set[int]]:
        """Return the watched channels, and those with a new watcher since the last call."""
        with self._lock:
            self._notified = False
            late, self._late = self._late, set()
            return set(self._watched), late

    # -- parameters ---------------------------------------------------------------------------------------------------

    @override
    def on_get_parameters(
        self,
        client: Client,  # every client may read
        param_names: list[str],
        request_id: str | None = None,  # the SDK adds it to the reply
    ) -> list[Parameter]:
        """Return parameters; all if the client names none."""
        return self.parameters.answer(param_names) if self.parameters else []

    @override
    def on_set_parameters(
        self,
        client: Client,
        parameters: list[Parameter],
        request_id: str | None = None,
    ) -> list[Parameter]:
        """Set parameters, and return their values afterwards, which the SDK sends to all subscribers."""
        return self.parameters.change(client.id, parameters) if self.parameters else []

    # -- what clients publish-------------------------------------------------------------------------------------------

    @override
    def on_client_advertise(self, client: Client, channel: ClientChannel) -> None:
        """Record that a client will publish.

        On the channel `MARK`, instead identify the client by the topic: a secret from `bridge.foxglove.front`.
        """
        if channel.id == MARK:
            self._visitors.identify(client.id, channel.topic)
            return
        advertised = Advertised(client.id, channel.id, channel.topic, channel.encoding, channel.schema_name)
        with self._lock:
            if self._count[client.id] < MOST_ADVERTISED:
                self._advertised[client.id, channel.id] = advertised
                self._count[client.id] += 1
                self._notify()

    @override
    def on_client_unadvertise(self, client: Client, client_channel_id: int) -> None:
        if client_channel_id == MARK:
            self._visitors.remove_client(client.id)
            return
        with self._lock:
            if self._advertised.pop((client.id, client_channel_id), None) is not None:
                self._count[client.id] -= 1
                self._count += Counter()  # remove zero counts
                self._notify()

    @override
    def on_message_data(self, client: Client, client_channel_id: int, data: bytes) -> None:
        with self._lock:
            channel = self._advertised.get((client.id, client_channel_id))
            if channel is None:
                return
            self._messages.append(ClientMessage(channel, data, steady()))
            self._size += len(data)
            while len(self._messages) > MOST_WAITING or (self._size > MOST_BYTES and len(self._messages) > 1):
                self._size -= len(self._messages.popleft().data)
                self.dropped += 1
            self._notify()

    def pop_published(self) -> tuple[Mapping[tuple[int, int], Advertised], list[ClientMessage]]:
        """Return the advertised channels, and the messages published since the last call."""
        with self._lock:
            messages, self._messages, self._size = list(self._messages), deque(), 0
            return dict(self._advertised), messages

    def _notify(self) -> None:
        if not self._notified:
            self._notified = True
            self._changed()
