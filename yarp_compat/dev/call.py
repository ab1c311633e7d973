"""A method of an interface as it is on the wire: its request, its reply, and both taken apart.

A request is one list: the method's name split at ``_`` (words of up to four letters as vocabs, longer ones as strings),
then the arguments. The reply is a list of the results; a result alone that is a list itself stands for the reply.
(`yarp/os/idl/WireWriter.cpp`, `yarpidl_thrift/src/t_yarp_generator.cc`, captures of 3.9.1, 3.12.3 and 4.0)
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, get_args, get_origin, get_type_hints

from yarp_compat.dev.fields import Field, Nested, field_of
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.wire.errors import Incomplete, WireError
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.tags import INT32, LIST, STRING, VOCAB32
from yarp_compat.wire.writer import Writer

_ONE, _THREE = struct.Struct("<i"), struct.Struct("<iii")


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply taken apart.

    Attributes:
        results: what the method returned.
        size: bytes that it took.
        generation: the one that wrote it, as far as its bytes tell.
    """

    results: list[Any]
    size: int
    generation: Generation


@dataclass(frozen=True, slots=True)
class Call:
    """A method.

    Attributes:
        name: its name.
        arguments: their names and types.
        results: the types of what it returns.
        alone: it returns one value, not a structure of several.
        prototype: what help says of it.
    """

    name: str
    arguments: tuple[tuple[str, Field], ...]
    results: tuple[Field, ...]
    alone: bool
    prototype: str

    @classmethod
    def of(cls, method: Callable[..., Any]) -> Call:
        """The call that a method's annotations declare.

        Raises:
            TypeError: one of them is no type of YARP's interfaces.
        """
        hints = get_type_hints(method, include_extras=True)
        returned = hints.pop("return", None)
        alone = get_origin(returned) is not tuple
        kinds = () if returned in (None, type(None)) else (returned,) if alone else get_args(returned)
        arguments = tuple((name, field_of(hint)) for name, hint in hints.items())
        results = tuple(map(field_of, kinds))
        listed = ", ".join(f"{field.name} {name}" for name, field in arguments)
        returns = " ".join(field.name for field in results) or "void"
        prototype = f"{returns} {method.__name__}({listed})"
        return cls(method.__name__, arguments, results, alone and bool(results), prototype)

    @property
    def tells(self) -> bool:
        """Whether the first of its results is the call's outcome."""
        return bool(self.results) and getattr(self.results[0], "kind", None) is ReturnValue

    def request(self, arguments: Sequence[Any], profile: Profile) -> bytes:
        """The request with these arguments.

        Raises:
            WireError: there are more or fewer than the method has, or one is not of its type.
        """
        if len(arguments) != len(self.arguments):
            raise WireError(f"{self.name} takes {len(self.arguments)} arguments, not {len(arguments)}")
        out = Writer(profile)
        words = self.name.split("_")
        out.begin(len(words) + len(arguments))
        for word in words:
            (out.vocab if len(word) <= 4 else out.string)(word)
        for (name, field), value in zip(self.arguments, arguments, strict=True):
            try:
                field.write(out, value)
            except WireError as error:
                raise WireError(f"{self.name}, {name}: {error}") from None
        return out.payload()

    def read_arguments(self, source: Reader) -> list[Any]:
        """The arguments of a request, whose name has been read.

        Raises:
            WireError: one is missing or not of its type.
        """
        found = []
        for name, field in self.arguments:
            try:
                found.append(field.read(source))
            except WireError as error:
                raise type(error)(f"{self.name}, {name}: {error}") from None
        return found

    def reply(self, results: Sequence[Any], generation: Generation, profile: Profile | None = None) -> bytes:
        """The reply with these results.

        Args:
            results: as many as the method has.
            generation: how the outcome is written.
            profile: whose tags; by default the generation's.

        Raises:
            WireError: a result is not of its type.
        """
        out = Writer(profile or generation.profile, generation)
        if not (self._itself and not (self.tells and generation is Generation.YARP_3_6)):
            out.begin(len(self.results))
        for place, (field, value) in enumerate(zip(self.results, results, strict=True)):
            try:
                field.write(out, value)
            except WireError as error:
                raise WireError(f"{self.name}, result {place}: {error}") from None
        return out.payload()

    def read_reply(self, data: Buffer, generation: Generation) -> Reply:
        """Take a reply apart.

        Args:
            data: it begins with the reply; more may follow.
            generation: the server's, as far as it is known: where the bytes tell another, that counts.

        Raises:
            WireError: it is none of this method's, such as ``[fail]`` of a server that does not know it; Incomplete:
                it has not ended yet.
        """
        if self.tells:
            generation = _told(data, generation, alone=self.alone)
        source = Reader(data, generation.profile, generation)
        if self._itself:
            return Reply([self.results[0].read(source)], source.at, generation)
        count = source.begin()
        if count != len(self.results):
            raise WireError(f"{self.name} returns {len(self.results)} values, and the reply has {count}")
        found = [field.read(source) for field in self.results]
        source.end()
        return Reply(found, source.at, generation)

    @property
    def _itself(self) -> bool:
        """Whether the one result is the reply, being a list of its own."""
        return self.alone and isinstance(self.results[0], Nested)


def _told(data: Buffer, generation: Generation, *, alone: bool) -> Generation:
    """The generation that wrote a reply with an outcome, where its first bytes tell."""
    try:
        first = _ONE.unpack_from(data, 0)[0] if alone else _THREE.unpack_from(data, 0)[2]
    except struct.error as error:
        raise Incomplete(f"{memoryview(data).nbytes} bytes do not hold a call's outcome") from error
    if alone and first & LIST:
        return generation  # ([ok]) of 3.6 to 3.10 and of 4.0 are the same
    if first & LIST:
        return Generation.YARP_4
    if first in (VOCAB32, STRING):
        return Generation.YARP_3_6
    if first == INT32:  # "ok" of 3.12, or "failed" of 3.11 without a tag
        return generation if generation is Generation.YARP_3_11 else Generation.YARP_3_12
    return Generation.YARP_3_11
