"""A server of a YARP device interface that replies to each client in the client's generation of YARP.

It accepts the requests that YARP's servers accept: the method name as one or several words, each a vocab or a string,
in a list with or without a common element type; ``help``; and ``getRemoteProtocolVersion``, with which YARP 4's clients
begin. Unknown requests get ``[fail]``. If a client's generation is a guess, failures are sent so that no generation
reads them as success (`yarp_compat.dev.returnvalue`).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import Any

from yarp_compat.dev import returnvalue
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.service import INTRODUCTION, Call, Service, write_version
from yarp_compat.overriding import override
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
SILENCE = 1.0  # minimum seconds between log lines of one server, because a client could flood the log
_HELP = (
    "help([functionName])",
    "Return list of available commands, or help message for a specific function",
    "@param functionName name of the command to describe; without it all names are listed",
)

_OTHER = {Generation.YARP_3_12: Generation.YARP_3_6, Generation.YARP_3_6: Generation.YARP_3_12}
"""The generation to try for a client that could not read a reply; both encodings have the same length."""


class Server:
    """Replies to requests by calling the implementation of a service.

    Use the object as the ``on_message`` of a port, and :meth:`on_event` as the port's ``on_event``. ``generations``
    stores the generation of each client; the owner may read it for a status.
    """

    def __init__(self, service: Service, generations: Generations | None = None) -> None:
        self._service = service
        self._calls = type(service).calls()
        self._longest = max((name.count("_") + 1 for name in self._calls), default=1)
        self.generations = Generations() if generations is None else generations
        self.refused = 0  # number of invalid requests
        self._silent = 0.0
        self._last_location: dict[str, str] = {}  # the last location that each client requested and received

    def __call__(self, request: PortMessage) -> None:
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
        """Handle the start or end of a connection: the next client of the same name may use another YARP release."""
        if event.incoming and event.up:
            self.generations.connected(event.route.source, event.route.carrier, event.address)
        elif event.incoming:
            self.generations.forget(event.route.source, event.address)
            self._last_location.pop(event.route.source, None)

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
        """Return the reply to a port's request over a connection (``link``), in the port's dialect if that is known.

        ``text``: the reply is printed, so it must be a Bottle; ``acked``: the carrier acknowledges, so
        `returnvalue.SPARE` bytes can follow.
        """
        if not text:
            inspect_client(self.generations, peer, profile, link)
        decision = self.generations.of(peer, profile, link)
        likely = profile or decision.generation.profile
        try:
            name, call, arguments, dialect = self.parse_request(payload, likely)
        except WireError as error:
            reply = self._run_command(payload, profile, likely)
            if reply is not None:
                return reply
            self.refused += 1
            self._log("rejected a request from %s: %s", peer or "?", error)
            return _fail()
        if name == HELP and not arguments:
            reply = self._run_command(payload, profile, likely)
            if reply is not None:
                return reply
        if call is None:
            return self._special(name, arguments, peer, profile, link, text=text)
        if text:
            reason = "text carrier"
        elif "_" in _first_word(payload, dialect) and not self.generations.of(peer, profile, link).sure:
            # generated code splits names at "_", so this name comes from a user of `yarp rpc` or from a script: reply
            # with a Bottle
            reason = "typed request"
        else:
            decision = self._decide(call, arguments, dialect, peer, profile, link)
            return self._execute(call, arguments, decision, decision.generation.profile, acked=acked)
        return self._execute(call, arguments, GenerationDecision(peer, Generation.YARP_3_6, reason), dialect)

    def _decide(
        self, call: Call, arguments: list[Any], dialect: Profile, peer: str, profile: Profile | None, link: PeerAddress
    ) -> GenerationDecision:
        """Decide the generation of the reply from the request and the connection."""
        generations = self.generations
        if dialect is not generations.of(peer, profile, link).generation.profile:
            generations.recognized(peer, dialect, link)
        if generations.of(peer, profile, link).generation.profile is Profile.YARP3:
            if call.since is not None:
                generations.called(peer, call.name, call.since, link)
            if call.before is not None:
                reason = f"it called {call.name}, as clients before {call.before.value} do"
                generations.findings.add(peer, ReleaseFinding(Generation.YARP_3_6, reason), link)
        decision = self._revise_guess(call, arguments, peer, generations.of(peer, profile, link), link)
        trial = generations.findings.trial_of(peer) if call.name == LOCATIONS and not decision.sure else None
        if trial is not None:
            return GenerationDecision(peer, trial.generation, "a trial", decision.cure)
        cure = generations.hint(decision) if call.has_outcome else ""
        if cure:
            text = (
                "the YARP release of %s is unknown (%s); replying as YARP %s, "
                "with failures that no release reads as success; %s"
            )
            log.warning(text, peer or "?", decision.reason, decision.generation.value, cure)
        return decision

    def _revise_guess(
        self, call: Call, arguments: list[Any], peer: str, decision: GenerationDecision, link: PeerAddress
    ) -> GenerationDecision:
        """Change the guess if the client could not read the last reply.

        ``navigation2D_nwc_yarp`` requests the area of a name only after its request for the location has failed
        (``gotoTargetByLocationName``, 3.6 to 4.0).
        """
        location, other = self._last_location.pop(peer, None), _OTHER.get(decision.generation)
        if decision.sure or other is None or call.name != "get_area_RPC" or location is None:
            return decision
        if location != arguments[0]:
            return decision
        reason = f"a guess: it requested the area {location!r} although it had received the location"
        self.generations.findings.add(peer, ReleaseFinding(other, reason, sure=False), link)
        return self.generations.of(peer, decision.generation.profile, link)

    def _run_command(self, payload: Buffer, profile: Profile | None, likely: Profile) -> bytes | None:
        """Return the reply to a text command; None if the service does not support the command."""
        try:
            values = self._service.command(decode(payload, profile))
            return None if values is None else encode(begun_by_vocab(values), likely)
        except WireError:
            return None
        except (ValueError, CallFailed) as error:
            return encode([Vocab("fail"), str(error)], likely)
        except Exception:
            self._log("a command failed", exc_info=True)
            return _fail()

    def parse_request(self, payload: Buffer, likely: Profile) -> tuple[str, Call | None, list[Any], Profile]:
        """Return a request's name, call, arguments (without surplus ones) and dialect.

        The dialect is the one that fits all bytes, or else the likely one if it fits the beginning.
        """
        other = Profile.YARP3 if likely is Profile.YARP4 else Profile.YARP4
        first: WireError | None = None
        for profile, whole in ((likely, True), (other, True), (likely, False)):
            source = ElementReader(payload, profile)
            try:
                name, call = self._read_name(source)
                arguments = [] if call is None else call.read_arguments(source)
                if call is None and source.left:
                    arguments = [source.word()]
                if whole:
                    source.finish()
            except WireError as error:
                first = first or error
            else:
                return name, call, arguments, profile
        raise first or WireError("no profile fits")

    def _read_name(self, source: ElementReader) -> tuple[str, Call | None]:
        """Return the name in a request, and its call; the call is None for the names that every service has."""
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

    def _execute(
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
            self._log("%s for %s failed", call.name, peer, exc_info=True)
            results = _failed(call, ReturnCode.GENERIC)
        if results is None:
            return _fail()
        if call.name == "get_location_RPC" and results[0] and decision.peer.endswith("/locations/rpc"):
            self._last_location[decision.peer] = arguments[0]
        trial = self.generations.findings.trial_of(decision.peer) if call.name == LOCATIONS else None
        if trial is not None and trial.generation is decision.generation:
            trial.answered = bool(results[0] and results[1])
        try:
            return _encode(call, results, decision, profile, acked=acked)
        except WireError:
            self._log("the result of %s for %s cannot be encoded", call.name, peer, exc_info=True)
            failed = _failed(call, ReturnCode.GENERIC)
            return _fail() if failed is None else _encode(call, failed, decision, profile, acked=acked)

    def _log(self, text: str, *arguments: object, exc_info: bool = False) -> None:
        now = time.monotonic()
        if now >= self._silent:
            self._silent = now + SILENCE
            log.warning(f"%s: {text}", type(self._service).__name__, *arguments, exc_info=exc_info)  # noqa: G004


def _first_word(payload: Buffer, profile: Profile) -> str:
    source = ElementReader(payload, profile)
    source.begin()
    return source.word()


class _Outcome(bytes):
    """A reply of `returnvalue.outcome_only`, which needs `returnvalue.SPARE` bytes after its acknowledgment."""


def _encode(call: Call, results: list[Any], decision: GenerationDecision, profile: Profile, *, acked: bool) -> bytes:
    """Encode the reply so that a peer whose generation is a guess reads no failure as a success."""
    if call.has_outcome and not decision.sure and isinstance(results[0], ReturnValue):
        if acked and call.single and decision.generation.profile is Profile.YARP3:
            return _Outcome(returnvalue.outcome_only(results[0]))
        if not results[0] and not (call.single and decision.generation is Generation.YARP_3_12):
            results = [returnvalue.Refused(results[0].code), *results[1:]]
    return call.reply(results, decision.generation, profile)


def _results(call: Call, returned: Any) -> list[Any]:
    if not call.results:
        return []
    if call.single:
        return [returned]
    if isinstance(returned, ReturnValue):
        if not returned:
            return [returned, *_defaults(call)]
        returned = (returned,)
    if len(returned) != len(call.results):
        raise WireError(f"{call.name} must return {len(call.results)} values, not {len(returned)}")
    return list(returned)


def _failed(call: Call, code: ReturnCode) -> list[Any] | None:
    """Return the results of a failed call: its outcome, and C++'s defaults for the rest."""
    return [ReturnValue(code), *_defaults(call)] if call.has_outcome else None


def _defaults(call: Call) -> list[Any]:
    return [field.default() for field in call.results[1:]]


def _fail() -> bytes:
    out = ElementWriter(Profile.YARP3)
    out.begin(1, VOCAB32)
    out.vocab("fail", tagged=False)
    return out.payload()


class DeviceCalls:
    """Calls the methods of a device: any object that has some of YARP's methods.

    The device's methods return a result, None or a `ReturnValue`, or raise an exception.
    """

    def __init__(self, device: object) -> None:
        self._device = device

    def done(self, method: str, *arguments: Any) -> ReturnValue:
        """Call a method without a result and return its outcome."""
        returned = self._method(method)(*arguments)
        return returned if isinstance(returned, ReturnValue) else OK

    def result(self, method: str, *arguments: Any, lacking: str) -> Any:
        """Call a method and return its result; ``lacking`` is the error text if the method returns no result."""
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
    """Serves clients of every release of YARP, on their connections' threads; see also `Server` and `OpenPort`."""

    def __init__(self, name: str, service: Service, *, generations: Generations | None = None, **options: Any) -> None:
        self._server = Server(service, generations)
        options = {"is_output": False, "rpc": True, "on_event": self._server.on_event, **options}
        super().__init__(name, **options)

    @override
    def _on_message(self, message: PortMessage) -> None:
        self._server(message)
