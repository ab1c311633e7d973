"""Answers the requests to an interface, each peer in its own generation of YARP.

What it takes is what YARP's servers take: the name in one word or in several, vocabs or strings, in a list that says
its elements' type or not; ``help``; the introduction of YARP 4's clients. What nobody knows is answered by ``[fail]``.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from typing import Any, Protocol

from yarp_compat.dev.call import Call
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.service import INTRODUCTION, Service, write_version
from yarp_compat.ports.events import ConnectionEvent
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reader import Reader
from yarp_compat.wire.tags import VOCAB32
from yarp_compat.wire.values import Vocab, begun_by_vocab
from yarp_compat.wire.writer import Writer

log = logging.getLogger(__name__)

HELP = "help"
SILENCE = 1.0
"""Seconds between two lines in the log of one server: a peer cannot fill it."""
_HELP = (
    "help([functionName])",
    "Return list of available commands, or help message for a specific function",
    "@param functionName name of the command to describe; without it all names are listed",
)


class Request(Protocol):
    """A message that a port received."""

    payload: Buffer

    @property
    def peer(self) -> Any:
        """The connection it came on: its route, carrier and profile."""

    def reply(self, payload: Buffer) -> None:
        """Answer it."""


class Server:
    """Makes an interface's implementation what a port calls for each message.

    It is a port's ``on_message``, and its :meth:`on_event` the port's.

    Args:
        service: the implementation.
        generations: what peers are answered in; kept by who owns it, so that it can be shown.
    """

    def __init__(self, service: Service, generations: Generations | None = None) -> None:
        self._service = service
        self._calls = type(service).calls()
        self._longest = max((name.count("_") + 1 for name in self._calls), default=1)
        self.generations = Generations() if generations is None else generations
        self.refused = 0
        """Requests that were none."""
        self._silent = 0.0

    def __call__(self, request: Request) -> None:
        """Answer a message."""
        peer = request.peer
        name = peer.route.source
        request.reply(self.answer(request.payload, name, peer.profile, text=peer.carrier.text))
        if not peer.carrier.text and self.generations.of(name).generation is Generation.YARP_4:
            peer.profile = Profile.YARP4

    def on_event(self, event: ConnectionEvent) -> None:
        """Hear that a connection came or went: who calls now may be another than who had its name before."""
        if event.incoming and event.up:
            self.generations.forget(event.route.source)

    def answer(self, payload: Buffer, peer: str = "", profile: Profile | None = None, *, text: bool = False) -> bytes:
        """The reply to a request.

        Args:
            payload: the request.
            peer: the port that sent it.
            profile: its dialect, where that is known.
            text: the reply is printed, so it must be a Bottle.
        """
        generation = self.generations.of(peer).generation
        likely = profile or generation.profile
        try:
            words, call, arguments, found = self._taken(payload, likely)
        except WireError as error:
            said = self._commanded(payload, profile, likely)
            if said is not None:
                return said
            self.refused += 1
            self._log("a request of %s is refused: %s", peer or "?", error)
            return _fail()
        if words == HELP and not arguments:
            said = self._commanded(payload, profile, likely)
            if said is not None:
                return said
        if call is None:
            return self._special(words, arguments, peer, profile, text=text)
        if not text and found is not generation.profile:
            self.generations.recognised(peer, found)
            generation = self.generations.of(peer).generation
        if text:
            generation = Generation.YARP_3_6
        return self._called(call, arguments, generation, found if text else generation.profile, peer)

    def _commanded(self, payload: Buffer, profile: Profile | None, likely: Profile) -> bytes | None:
        """The answer to a request in words; None where it means nothing to the service."""
        try:
            said = self._service.command(decode(payload, profile))
            return None if said is None else encode(begun_by_vocab(said), likely)
        except WireError:
            return None
        except (ValueError, CallFailed) as error:
            return encode([Vocab("fail"), str(error)], likely)
        except Exception:
            self._log("a command", exc_info=True)
            return _fail()

    def _taken(self, payload: Buffer, likely: Profile) -> tuple[str, Call | None, list[Any], Profile]:
        """A request's name, call, arguments and dialect: the one in which all its bytes mean something.

        Arguments too many do no harm.
        """
        other = Profile.YARP3 if likely is Profile.YARP4 else Profile.YARP4
        first: WireError | None = None
        for profile, whole in ((likely, True), (other, True), (likely, False)):
            source = Reader(payload, profile)
            try:
                words, call = self._named(source)
                arguments = [] if call is None else call.read_arguments(source)
                if call is None and source.left:
                    arguments = [source.word()]
                if whole:
                    source.finish()
            except WireError as error:
                first = first or error
            else:
                return words, call, arguments, profile
        raise first or WireError("no profile fits")

    def _named(self, source: Reader) -> tuple[str, Call | None]:
        """The name in a request; without a call where it is one that every service knows."""
        source.begin()
        name = source.word()
        if name == "__direct__":
            name = source.word()
        while True:
            if name in (HELP, INTRODUCTION):
                return name, None
            if name in self._calls:
                return name, self._calls[name]
            if not source.left or name.count("_") + 1 >= self._longest:
                raise WireError(f"there is no method {name!r}")
            name += "_" + source.word()

    def _special(self, name: str, arguments: list[Any], peer: str, profile: Profile | None, *, text: bool) -> bytes:
        if name == INTRODUCTION and text:
            return encode([self._service.PROTOCOL, 4, 0, 0], Profile.YARP3)
        if name == INTRODUCTION:
            self.generations.introduced(peer, profile)
            return write_version(self._service.PROTOCOL, self.generations.of(peer).generation)
        return self._help(arguments[0] if arguments else "--all")

    def _help(self, name: str) -> bytes:
        if name == "--all":
            lines: Sequence[str] = ["*** Available commands:", *self._calls, HELP]
        elif name == HELP:
            lines = _HELP
        elif name in self._calls:
            lines = [self._calls[name].prototype]
        else:
            lines = ["Command not found"]
        out = Writer(Profile.YARP3)
        out.begin(2)
        out.vocab("many")
        out.begin(len(lines))
        for line in lines:
            out.string(line)
        return out.payload()

    def _called(self, call: Call, arguments: list[Any], generation: Generation, profile: Profile, peer: str) -> bytes:
        try:
            results: list[Any] | None = _results(call, getattr(self._service, call.name)(*arguments))
        except CallFailed as error:
            log.debug("%s for %s: %s", call.name, peer or "?", error)
            results = _failed(call, error.code)
        except NotImplementedError:
            results = _failed(call, ReturnCode.NOT_IMPLEMENTED)
        except Exception:
            self._log("%s for %s", call.name, peer or "?", exc_info=True)
            results = _failed(call, ReturnCode.GENERIC)
        if results is None:
            return _fail()
        try:
            return call.reply(results, generation, profile)
        except WireError:
            self._log("%s for %s returned what cannot be written", call.name, peer or "?", exc_info=True)
            failed = _failed(call, ReturnCode.GENERIC)
            return _fail() if failed is None else call.reply(failed, generation, profile)

    def _log(self, what: str, *arguments: object, exc_info: bool = False) -> None:
        now = time.monotonic()
        if now >= self._silent:
            self._silent = now + SILENCE
            log.warning(f"%s: {what}", type(self._service).__name__, *arguments, exc_info=exc_info)  # noqa: G004


def _results(call: Call, returned: Any) -> list[Any]:
    if not call.results:
        return []
    if call.alone:
        return [returned]
    if isinstance(returned, ReturnValue):
        if not returned:
            return [returned, *_defaults(call)]
        returned = (returned,)
    if len(returned) != len(call.results):
        raise WireError(f"{call.name} returns {len(call.results)} values, not {len(returned)}")
    return list(returned)


def _failed(call: Call, code: ReturnCode) -> list[Any] | None:
    """What a call that failed returns: its outcome, and of the rest what C++ has where nothing was set."""
    return [ReturnValue(code), *_defaults(call)] if call.tells else None


def _defaults(call: Call) -> list[Any]:
    return [field.default() for field in call.results[1:]]


def _fail() -> bytes:
    out = Writer(Profile.YARP3)
    out.begin(1, VOCAB32)
    out.vocab("fail", tagged=False)
    return out.payload()
