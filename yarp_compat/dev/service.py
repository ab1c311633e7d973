"""Interfaces as classes, the counterpart of YARP's generated (thrift) services in C++.

    class ILocalization2DMsgs(Service):
        @rpc
        def get_current_position1_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...

A server derives from the interface and defines its methods; :class:`yarp_compat.dev.server.Server` dispatches requests
to it. A client is the interface itself with a channel to a server: its methods call the server's.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, wraps
from inspect import isfunction, signature
from typing import Any, ClassVar, Protocol, TypeVar, get_args, get_origin, get_type_hints

from yarp_compat.dev.fields import FieldCodec, Nested, field_of
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.wire.binary import decode_prefix
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import INT32, LIST, STRING, VOCAB32

INTRODUCTION = "getRemoteProtocolVersion"
"""The method that clients of YARP 4 call first; 3.12 has it too, but its stock clients do not call it."""
VERSION = struct.Struct("<iihhhh")
"""The reply to `INTRODUCTION`, not a Bottle: a list of 1, the service's protocol, YARP's major, minor, patch number."""

_Method = TypeVar("_Method", bound=Callable[..., Any])


class Channel(Protocol):
    """A client's connection to its server; the server's replies set the channel's ``generation``."""

    generation: Generation

    def request(self, payload: bytes, parse: Callable[[Buffer], int]) -> Buffer:
        """Send a request and return the reply; ``parse`` returns the reply's length (or raises `Incomplete`)."""


class Service:
    """An interface. Clients call its methods marked with :func:`rpc` through a channel; servers need no channel."""

    PROTOCOL: ClassVar[int] = 0  # the protocol version for clients of YARP 4

    def __init__(self, channel: Channel | None = None) -> None:
        self._channel = channel

    @classmethod
    def calls(cls) -> Mapping[str, Call]:
        """Return all methods by name."""
        return _calls(cls)  # type: ignore[arg-type]  # a class can be hashed

    def introduce(self) -> tuple[int, int, int, int] | None:
        """Request the versions of the protocol and of YARP, as clients of 4.0 do; return them, None before 3.12."""
        channel = self._require_channel(INTRODUCTION)
        out = ElementWriter(Profile.YARP4)
        out.begin(1)
        out.string(INTRODUCTION)
        reply = channel.request(out.payload(), version_end)
        version = read_version(reply)
        if version is not None:
            channel.generation = Generation.YARP_3_12 if version[1] == 3 else Generation.YARP_4
        return version

    def command(self, words: list[Any]) -> Sequence[Any] | None:  # noqa: ARG002 - most services have none
        """Reply to a text command, such as modules accepted before they had services; None for any other request.

        ``words`` and the reply are a Bottle's values; the first of the reply may be a vocab as text (``[many]``).
        Raises `ValueError` with the reason for an invalid command.
        """
        return None

    def _require_channel(self, name: str) -> Channel:
        if self._channel is None:
            msg = f"{type(self).__name__} neither has a channel to a server nor defines {name}"
            raise NotImplementedError(msg)
        return self._channel


def rpc(method: _Method) -> _Method:
    """Mark a method of an interface: with a channel, calling it calls the server's method.

    The method's annotations are the types on the wire (see :mod:`yarp_compat.dev.fields`); ``tuple[ReturnValue, ...]``
    stands for YARP's structures ``return_...``. On a class, `rpc` marks all public methods that `Service` does not
    have.
    """
    if isinstance(method, type):
        for name, member in list(vars(method).items()):
            if isfunction(member) and not name.startswith("_") and not hasattr(Service, name):
                setattr(method, name, rpc(member))
        return method

    @wraps(method)
    def remote(self: Service, *arguments: Any, **named: Any) -> Any:
        if named:
            arguments = signature(method).bind(self, *arguments, **named).args[1:]
        channel = self._require_channel(method.__name__)
        call = type(self).calls()[method.__name__]
        reply = channel.request(
            call.request(arguments, channel.generation.profile),
            lambda data: call.read_reply(data, channel.generation).size,
        )
        parsed = call.read_reply(reply, channel.generation)
        channel.generation = parsed.generation
        return parsed.results[0] if call.single else tuple(parsed.results) or None

    remote.__dict__["rpc"] = method
    return remote  # type: ignore[return-value] # it has the method's signature


def since(generation: Generation) -> Callable[[_Method], _Method]:
    """Mark a method that clients of older generations lack, so that its caller is known to be newer; below `rpc`."""

    def marked(method: _Method) -> _Method:
        method.__dict__["since"] = generation
        return method

    return marked


def before(generation: Generation) -> Callable[[_Method], _Method]:
    """Mark a method, or all methods of a class, that only clients of older generations call; below `rpc`."""

    def marked(method: _Method) -> _Method:
        methods = filter(isfunction, vars(method).values()) if isinstance(method, type) else (method,)
        for member in methods:
            member.__dict__["before"] = generation
        return method

    return marked


def write_version(protocol: int, generation: Generation = Generation.YARP_4) -> bytes:
    """Return the reply to ``getRemoteProtocolVersion``, as a server of the client's own generation sends it."""
    major, minor = map(int, generation.value.split("."))
    return VERSION.pack(LIST, 1, protocol, major, minor, 0)


def read_version(reply: Buffer) -> tuple[int, int, int, int] | None:
    """Return a server's protocol and version; None for any other reply."""
    if memoryview(reply).nbytes != VERSION.size:
        return None
    code, count, protocol, major, minor, patch = VERSION.unpack(reply)
    if (code, count) != (LIST, 1) or (protocol, major) == (VOCAB32, 0):
        return None
    return protocol, major, minor, patch


def version_end(data: Buffer) -> int:
    """Return the length of the reply to ``getRemoteProtocolVersion``; raises `Incomplete` if it is cut off."""
    size = memoryview(data).nbytes
    if size < 4:
        raise Incomplete(f"{size} bytes of a reply")
    if int.from_bytes(bytes(data[:4]), "little") != LIST:
        return decode_prefix(data, Profile.YARP4)[1]
    if size < VERSION.size:
        raise Incomplete(f"{size} bytes of a reply")
    return VERSION.size


@cache  # not stored in the classes: concurrent first calls would change the dict that another thread iterates over
def _calls(kind: type[Service]) -> Mapping[str, Call]:
    calls = {}
    for owner in reversed(kind.__mro__):
        for name, member in vars(owner).items():
            method = getattr(member, "rpc", None)
            if method is not None:
                calls[name] = Call.from_method(method)
    return calls


_ONE, _THREE = struct.Struct("<i"), struct.Struct("<iii")


@dataclass(frozen=True, slots=True)
class Reply:
    """A parsed reply: the method's results, the number of bytes, and the generation that wrote them."""

    results: list[Any]
    size: int
    generation: Generation


@dataclass(frozen=True, slots=True)
class Call:
    """A method. ``single``: it has one result, without a structure; ``since``, ``before``: see these decorators."""

    name: str
    arguments: tuple[tuple[str, FieldCodec], ...]
    results: tuple[FieldCodec, ...]
    single: bool
    prototype: str
    since: Generation | None = None
    before: Generation | None = None

    @classmethod
    def from_method(cls, method: Callable[..., Any]) -> Call:
        """Make the call that a method's annotations declare; raises `TypeError` for an unsupported type."""
        hints = get_type_hints(method, include_extras=True)
        returned = hints.pop("return", None)
        single = get_origin(returned) is not tuple
        kinds = () if returned in (None, type(None)) else (returned,) if single else get_args(returned)
        arguments = tuple((name, field_of(hint)) for name, hint in hints.items())
        results = tuple(map(field_of, kinds))
        listed = ", ".join(f"{field.name} {name}" for name, field in arguments)
        returns = " ".join(field.name for field in results) or "void"
        prototype = f"{returns} {method.__name__}({listed})"
        bounds = getattr(method, "since", None), getattr(method, "before", None)
        return cls(method.__name__, arguments, results, single and bool(results), prototype, *bounds)

    @property
    def has_outcome(self) -> bool:
        """Whether the method's first result is the call's outcome."""
        return bool(self.results) and getattr(self.results[0], "kind", None) is ReturnValue

    def request(self, arguments: Sequence[Any], profile: Profile) -> bytes:
        """Return the request with these arguments; raises `WireError` if their number or a type is wrong."""
        if len(arguments) != len(self.arguments):
            raise WireError(f"{self.name} takes {len(self.arguments)} arguments, not {len(arguments)}")
        out = ElementWriter(profile)
        parts = self.name.split("_")
        out.begin(len(parts) + len(arguments))
        for part in parts:
            (out.vocab if len(part) <= 4 else out.string)(part)
        for (name, field), value in zip(self.arguments, arguments, strict=True):
            try:
                field.write(out, value)
            except WireError as error:
                raise WireError(f"{self.name}, {name}: {error}") from None
        return out.payload()

    def read_arguments(self, source: ElementReader) -> list[Any]:
        """Read the arguments of a request after its name; raises `WireError` if one is missing or invalid."""
        values = []
        for name, field in self.arguments:
            try:
                values.append(field.read(source))
            except WireError as error:
                raise type(error)(f"{self.name}, {name}: {error}") from None
        return values

    def reply(self, results: Sequence[Any], generation: Generation, profile: Profile | None = None) -> bytes:
        """Encode results, with the tags of ``profile`` or else the generation's; raises `WireError` for wrong types."""
        out = ElementWriter(profile or generation.profile, generation)
        if not (self._is_bare and not (self.has_outcome and generation is Generation.YARP_3_6)):
            out.begin(len(self.results))
        for place, (field, value) in enumerate(zip(self.results, results, strict=True)):
            try:
                field.write(out, value)
            except WireError as error:
                raise WireError(f"{self.name}, result {place}: {error}") from None
        return out.payload()

    def read_reply(self, data: Buffer, generation: Generation) -> Reply:
        """Parse the reply at the start of ``data``; a generation that the bytes prove overrides the argument.

        Raises `WireError` if it is not a reply to this method (``[fail]``: the server lacks the method), `Incomplete`
        if the reply is cut off.
        """
        if self.has_outcome:
            generation = _generation_of(data, generation, single=self.single)
        source = ElementReader(data, generation.profile, generation)
        if self._is_bare:
            return Reply([self.results[0].read(source)], source.at, generation)
        count = source.begin()
        if count != len(self.results):
            raise WireError(f"{self.name} returns {len(self.results)} values, but the reply has {count}")
        results = [field.read(source) for field in self.results]
        source.end()
        return Reply(results, source.at, generation)

    @property
    def _is_bare(self) -> bool:
        """Whether the reply consists of the only result, which is a list itself."""
        return self.single and isinstance(self.results[0], Nested)


def _generation_of(data: Buffer, generation: Generation, *, single: bool) -> Generation:
    """Return the generation that wrote a reply with an outcome, as far as its first bytes show it."""
    try:
        first = _ONE.unpack_from(data, 0)[0] if single else _THREE.unpack_from(data, 0)[2]
    except struct.error as error:
        raise Incomplete(f"{memoryview(data).nbytes} bytes do not hold a call's outcome") from error
    if single and first & LIST:
        return generation  # ([ok]) of 3.6 to 3.10 and of 4.0 are the same
    if first & LIST:
        return Generation.YARP_4
    if first in (VOCAB32, STRING):
        return Generation.YARP_3_6
    if first == INT32:  # "ok" of 3.12, or "failed" of 3.11 without a tag
        return generation if generation is Generation.YARP_3_11 else Generation.YARP_3_12
    return Generation.YARP_3_11
