"""Answers the requests to an interface, each client in its own generation of YARP.

It accepts what YARP's servers accept: the name in one word or in several, vocabs or strings, in a list with or without
its elements' type; ``help``; the introduction of YARP 4's clients. Unknown requests are answered by ``[fail]``.
If a client's generation is a guess, no generation reads a failure as success (`yarp_compat.dev.returnvalue`).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import Any

from yarp_compat.dev import returnvalue
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.service import INTRODUCTION, Call, Service, write_version
from yarp_compat.ports.client_process import inspect_client
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.ports.message import PortMessage
from yarp_compat.pythonic import OpenPort
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation, GenerationDecision, Generations, PeerAddress, ReleaseFinding
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import VOCAB32
from yarp_compat.wire.values import Vocab, begun_by_vocab

log = logging.getLogger(__name__)

HELP = "help"
LOCATIONS = "get_locations_list_RPC"
SILENCE = 1.0  # seconds between two lines of one server in the log, which a client could fill otherwise
_HELP = (
    "help([functionName])",
    "Return list of available commands, or help message for a specific function",
    "@param functionName name of the command to describe; without it all names are listed",
)

_OTHER = {Generation.YARP_3_12: Generation.YARP_3_6, Generation.YARP_3_6: Generation.YARP_3_12}
"""The generation to try for a client that did not read a reply: both replies have the same length."""


class Server:
    """Answers with an interface's implementation: a port's ``on_message`` and, as :meth:`on_event`, ``on_event``.

    ``generations`` has the generation of each client, also for the owner's status.
    """

    def __init__(self, service: Service, generations: Generations | None = None) -> None:
        self._service = service
        self._calls = type(service).calls()
        self._longest = max((name.count("_") + 1 for name in self._calls), default=1)
        self.generations = Generations() if generations is None else generations
        self.refused = 0  # invalid requests
        self._silent = 0.0
        self._given: dict[str, str] = {}  # the location that a client asked for last and was given

    def __call__(self, request: PortMessage) -> None:
        """Answer a message."""
        peer = request.peer
        name, link = peer.route.source, peer.address
        reply = self.answer(request.payload, name, peer.profile, link, text=peer.carrier.text, acked=peer.carrier.ack)
        if isinstance(reply, _Outcome):
            request.reply(reply, slack=returnvalue.SPARE)
        else:
            request.reply(reply)
        if not peer.carrier.text and self.generations.of(name, peer.profile, link).generation is Generation.YARP_4:
            peer.profile = Profile.YARP4

    def on_event(self, event: ConnectionEvent) -> None:
        """Note that a connection began or ended: the next client with its name may have another release."""
        if event.incoming and event.up:
            self.generations.connected(event.route.source, event.route.carrier, event.address)
        elif event.incoming:
            self.generations.forget(event.route.source, event.address)
            self._given.pop(event.route.source, None)

    def answer(
        self,
        payload: Buffer,
        peer: str = "",
        profile: Profile | None = None,
        link: PeerAddress = ("", 0),
        *,
        text: bool = False,
        acked: bool = False,
    ) -> bytes:
        """Return the reply to a request of a port over a connection (``link``), in its dialect if that is known.

        ``text``: it is printed, so it must be a Bottle; ``acked``: the carrier acknowledges, so `returnvalue.SPARE`
        bytes can follow.
        """
        if not text:
            inspect_client(self.generations, peer, profile, link)
        decision = self.generations.of(peer, profile, link)
        likely = profile or decision.generation.profile
        try:
            words, call, arguments, found = self.taken(payload, likely)
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
            return self._special(words, arguments, peer, profile, link, text=text)
        if text:
            reason = "it is text"
        elif "_" in _first_word(payload, found) and not self.generations.of(peer, profile, link).sure:
            # generated code splits names: this is a person at `yarp rpc` or a script, and expects a Bottle
            reason = "its words are typed"
        else:
            decision = self._learned(call, arguments, found, peer, profile, link)
            return self._called(call, arguments, decision, decision.generation.profile, acked=acked)
        return self._called(call, arguments, GenerationDecision(peer, Generation.YARP_3_6, reason), found)

    def _learned(
        self, call: Call, arguments: list[Any], found: Profile, peer: str, profile: Profile | None, link: PeerAddress
    ) -> GenerationDecision:
        """Decide the generation of the answer, by all that the request and the connection disclose."""
        generations = self.generations
        if found is not generations.of(peer, profile, link).generation.profile:
            generations.recognised(peer, found, link)
        if generations.of(peer, profile, link).generation.profile is Profile.YARP3:
            if call.since is not None:
                generations.called(peer, call.name, call.since, link)
            if call.before is not None:
                reason = f"it called {call.name}, as clients before {call.before.value} do"
                generations.findings.add(peer, ReleaseFinding(Generation.YARP_3_6, reason), link)
        decision = self._reacted(call, arguments, peer, generations.of(peer, profile, link), link)
        trial = generations.findings.trial_of(peer) if call.name == LOCATIONS and not decision.sure else None
        if trial is not None:
            return GenerationDecision(peer, trial.generation, "a trial", decision.cure)
        cure = generations.hint(decision) if call.tells else ""
        if cure:
            what = "the YARP release of %s is unknown (%s); its calls are answered as by %s, with care; %s"
            log.warning(what, peer or "?", decision.reason, decision.generation.value, cure)
        return decision

    def _reacted(
        self, call: Call, arguments: list[Any], peer: str, decision: GenerationDecision, link: PeerAddress
    ) -> GenerationDecision:
        """Change the guess if the client did not read the last reply.

        ``navigation2D_nwc_yarp`` asks for the area of a name only after the location failed
        (``gotoTargetByLocationName``, 3.6 to 4.0).
        """
        given, other = self._given.pop(peer, None), _OTHER.get(decision.generation)
        if decision.sure or other is None or call.name != "get_area_RPC" or given is None or given != arguments[0]:
            return decision
        reason = f"a guess: it asked for the area {given!r} although it had been given the location"
        self.generations.findings.add(peer, ReleaseFinding(other, reason, sure=False), link)
        return self.generations.of(peer, decision.generation.profile, link)

    def _commanded(self, payload: Buffer, profile: Profile | None, likely: Profile) -> bytes | None:
        """Return the answer to a request in words; None if it means nothing to the service."""
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

    def taken(self, payload: Buffer, likely: Profile) -> tuple[str, Call | None, list[Any], Profile]:
        """A request's name, call, arguments (too many do no harm) and dialect, in which all bytes mean something."""
        other = Profile.YARP3 if likely is Profile.YARP4 else Profile.YARP4
        first: WireError | None = None
        for profile, whole in ((likely, True), (other, True), (likely, False)):
            source = ElementReader(payload, profile)
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

    def _named(self, source: ElementReader) -> tuple[str, Call | None]:
        """Return the name in a request and its call; None for the names that every service knows."""
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
                raise WireError(f"unknown method {name!r}")
            name += "_" + source.word()

    def _special(
        self, name: str, arguments: list[Any], peer: str, profile: Profile | None, link: PeerAddress, *, text: bool
    ) -> bytes:
        if name == INTRODUCTION and text:
            return encode([self._service.PROTOCOL, 4, 0, 0], Profile.YARP3)
        if name == INTRODUCTION:
            self.generations.introduced(peer, profile, link)
            return write_version(self._service.PROTOCOL, self.generations.of(peer, link=link).generation)
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
        out = ElementWriter(Profile.YARP3)
        out.begin(2)
        out.vocab("many")
        out.begin(len(lines))
        for line in lines:
            out.string(line)
        return out.payload()

    def _called(
        self, call: Call, arguments: list[Any], decision: GenerationDecision, profile: Profile, *, acked: bool = False
    ) -> bytes:
        peer = decision.peer or "?"
        try:
            results: list[Any] | None = _results(call, getattr(self._service, call.name)(*arguments))
        except CallFailed as error:
            log.debug("%s for %s: %s", call.name, peer, error)
            results = _failed(call, error.code)
        except NotImplementedError:
            results = _failed(call, ReturnCode.NOT_IMPLEMENTED)
        except Exception:
            self._log("%s for %s", call.name, peer, exc_info=True)
            results = _failed(call, ReturnCode.GENERIC)
        if results is None:
            return _fail()
        if call.name == "get_location_RPC" and results[0] and decision.peer.endswith("/locations/rpc"):
            self._given[decision.peer] = arguments[0]
        trial = self.generations.findings.trial_of(decision.peer) if call.name == LOCATIONS else None
        if trial is not None and trial.generation is decision.generation:
            trial.answered = bool(results[0] and results[1])
        try:
            return _written(call, results, decision, profile, acked=acked)
        except WireError:
            self._log("%s for %s returned what cannot be written", call.name, peer, exc_info=True)
            failed = _failed(call, ReturnCode.GENERIC)
            return _fail() if failed is None else _written(call, failed, decision, profile, acked=acked)

    def _log(self, what: str, *arguments: object, exc_info: bool = False) -> None:
        now = time.monotonic()
        if now >= self._silent:
            self._silent = now + SILENCE
            log.warning(f"%s: {what}", type(self._service).__name__, *arguments, exc_info=exc_info)  # noqa: G004


def _first_word(payload: Buffer, profile: Profile) -> str:
    source = ElementReader(payload, profile)
    source.begin()
    return source.word()


class _Outcome(bytes):
    """A reply of `returnvalue.alone`, which wants `returnvalue.SPARE` bytes after its acknowledgement."""


def _written(call: Call, results: list[Any], decision: GenerationDecision, profile: Profile, *, acked: bool) -> bytes:
    """The reply, such that a peer whose generation is a guess reads no failure as a success."""
    if call.tells and not decision.sure and isinstance(results[0], ReturnValue):
        if acked and call.alone and decision.generation.profile is Profile.YARP3:
            return _Outcome(returnvalue.alone(results[0]))
        if not results[0] and not (call.alone and decision.generation is Generation.YARP_3_12):
            results = [returnvalue.Refused(results[0].code), *results[1:]]
    return call.reply(results, decision.generation, profile)


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
    """The results of a call that failed: its outcome, and C++'s defaults for the rest."""
    return [ReturnValue(code), *_defaults(call)] if call.tells else None


def _defaults(call: Call) -> list[Any]:
    return [field.default() for field in call.results[1:]]


def _fail() -> bytes:
    out = ElementWriter(Profile.YARP3)
    out.begin(1, VOCAB32)
    out.vocab("fail", tagged=False)
    return out.payload()


class DeviceCalls:
    """Calls a device: any object with some methods of YARP, which return results, None or an outcome, or raise."""

    def __init__(self, device: object) -> None:
        self._device = device

    def done(self, method: str, *arguments: Any) -> ReturnValue:
        """The outcome of a method that returns nothing."""
        returned = self._method(method)(*arguments)
        return returned if isinstance(returned, ReturnValue) else OK

    def found(self, method: str, *arguments: Any, lacking: str) -> Any:
        """Return the result of a method; ``lacking`` is the error if it returns None."""
        returned = self._method(method)(*arguments)
        if isinstance(returned, ReturnValue):
            raise CallFailed(returned.code if not returned else ReturnCode.METHOD_FAILED, lacking)
        if returned is None:
            raise CallFailed(ReturnCode.METHOD_FAILED, lacking)
        return returned

    def _method(self, name: str) -> Callable[..., Any]:
        method = getattr(self._device, name, None)
        if method is None:
            raise NotImplementedError(name)
        return method  # type: ignore[no-any-return] # any object's method


class ServiceServer(OpenPort):
    """Answers clients of every release of YARP, each on its connection's thread; more as of `Server`, `OpenPort`."""

    def __init__(self, name: str, service: Service, *, generations: Generations | None = None, **options: Any) -> None:
        self._server = Server(service, generations)
        options = {"is_output": False, "rpc": True, "on_event": self._server.on_event, **options}
        super().__init__(name, **options)

    def _take(self, message: PortMessage) -> None:
        self._server(message)
