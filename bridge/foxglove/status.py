"""The server's part of the status document."""

from __future__ import annotations

from pydantic import Field

from bridge.status import Int, Number, Part, Text, WorkerStatus


class ChannelStatus(Part):
    """A watched topic; or a client's channel, with the client and the reason of a refusal. Other keys: counters."""

    topic: Text
    type: Text
    end: Text
    by: Text = ""
    why: Text = ""


class ClientStatus(Part):
    """A connected client; ``since``: seconds since it connected, ``bytes``: number of bytes sent to it."""

    who: Text
    role: Text
    bytes: Int
    since: Number


class FoxgloveStatus(WorkerStatus):
    """The status of the server; ``channels``: number of offered topics, ``dropped``: number of lost client messages."""

    clients: list[ClientStatus] = Field(default=[])
    topics: list[ChannelStatus] = Field(default=[])
    services: Int = 0
    dropped: Int = 0
    channels: Int = 0
