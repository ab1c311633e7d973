"""Interfaces as classes: what YARP's generated (thrift) services are to C++.

    class ILocalization2DMsgs(Service):
        @rpc
        def get_current_position1_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...

A server derives from the interface and defines its methods; :class:`yarp_compat.dev.server.Server` answers requests
with it. A client is the interface itself, made with a channel to a server: its methods call the server's.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, ClassVar, Protocol, TypeVar

from yarp_compat.dev.call import Call
from yarp_compat.wire.binary import decode_prefix
from yarp_compat.wire.errors import Incomplete
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import LIST, VOCAB32
from yarp_compat.wire.writer import Writer

INTRODUCTION = "getRemoteProtocolVersion"
"""The method that clients of YARP 4 call before any other; 3.12 has it too, and its stock clients do not call it."""
VERSION = struct.Struct("<iihhhh")
"""Its reply, which is no Bottle: a list of 1, then the service's protocol, YARP's major, minor and patch number."""

_Method = TypeVar("_Method", bound=Callable[..., Any])


class Channel(Protocol):
    """How a client reaches its server.

    Attributes:
        generation: the server's; set by what it answers.
    """

    generation: Generation

    def request(self, payload: bytes, parse: Callable[[Buffer], int]) -> Buffer:
        """Send a request and return the reply, which ends where ``parse`` says (it raises Incomplete for more)."""


class Service:
    """An interface; its methods marked :func:`rpc` are what clients can call.

    Args:
        channel: how its server is reached; none where this is the server.
    """

    PROTOCOL: ClassVar[int] = 0
    """The protocol that clients of YARP 4 ask for."""
    _calls_made: ClassVar[Mapping[str, Call]]

    def __init__(self, channel: Channel | None = None) -> None:
        self._channel = channel

    @classmethod
    def calls(cls) -> Mapping[str, Call]:
        """All its methods by name."""
        found = cls.__dict__.get("_calls_made")
        if found is None:
            found = cls._calls_made = _calls(cls)
        return found

    def introduce(self) -> tuple[int, int, int, int] | None:
        """Ask the server for its protocol, as clients of YARP 4 do; servers since 3.12 say it and what they are.

        Returns:
            the protocol, and YARP's major, minor and patch number; None where the server does not know the question.
        """
        channel = self._reached(INTRODUCTION)
        out = Writer(Profile.YARP4)
        out.begin(1)
        out.string(INTRODUCTION)
        reply = channel.request(out.payload(), version_end)
        version = read_version(reply)
        if version is not None:
            channel.generation = Generation.YARP_3_12 if version[1] == 3 else Generation.YARP_4
        return version

    def command(self, words: list[Any]) -> Sequence[Any] | None:  # noqa: ARG002 - most know none
        """Answer a request that is none of the methods: commands in words, as modules had them before their services.

        Args:
            words: the request as a Bottle's values.

        Returns:
            the answer's values, the first of which may be a vocab as text (``[many]``); None where it is no command.

        Raises:
            ValueError: the command is known and something is wrong with it; says what.
        """
        return None

    def _reached(self, name: str) -> Channel:
        if self._channel is None:
            msg = f"{type(self).__name__} has no channel to a server, and does not define {name} itself"
            raise NotImplementedError(msg)
        return self._channel


def rpc(method: _Method) -> _Method:
    """Mark a method of an interface: where the interface has a channel, calling it calls the server's.

    Its annotations are what is on the wire, see :mod:`yarp_compat.dev.fields`; ``tuple[ReturnValue, ...]`` is what
    YARP's structures ``return_...`` are.
    """

    @wraps(method)
    def remote(self: Service, *arguments: Any) -> Any:
        channel = self._reached(method.__name__)
        call = type(self).calls()[method.__name__]
        reply = channel.request(
            call.request(arguments, channel.generation.profile),
            lambda data: call.read_reply(data, channel.generation).size,
        )
        found = call.read_reply(reply, channel.generation)
        channel.generation = found.generation
        return found.results[0] if call.alone else tuple(found.results) or None

    remote.__dict__["rpc"] = method
    return remote  # type: ignore[return-value] # it is called as the method is


def write_version(protocol: int, generation: Generation = Generation.YARP_4) -> bytes:
    """The answer to a client's introduction, by a server of the client's own generation."""
    major, minor = map(int, generation.value.split("."))
    return VERSION.pack(LIST, 1, protocol, major, minor, 0)


def read_version(reply: Buffer) -> tuple[int, int, int, int] | None:
    """A server's protocol and version; None where the reply is another."""
    if memoryview(reply).nbytes != VERSION.size:
        return None
    code, count, protocol, major, minor, patch = VERSION.unpack(reply)
    if (code, count) != (LIST, 1) or (protocol, major) == (VOCAB32, 0):
        return None
    return protocol, major, minor, patch


def version_end(data: Buffer) -> int:
    """Where the reply to an introduction ends."""
    size = memoryview(data).nbytes
    if size < 4:
        raise Incomplete(f"{size} bytes of a reply")
    if int.from_bytes(bytes(data[:4]), "little") != LIST:
        return decode_prefix(data, Profile.YARP4)[1]
    if size < VERSION.size:
        raise Incomplete(f"{size} bytes of a reply")
    return VERSION.size


def _calls(kind: type[Service]) -> Mapping[str, Call]:
    found = {}
    for owner in reversed(kind.__mro__):
        for name, member in vars(owner).items():
            method = getattr(member, "rpc", None)
            if method is not None:
                found[name] = Call.of(method)
    return found
