"""A module's YARP ports, which open once a name server answers; `yarp_compat` then keeps them registered."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from typing_extensions import override

from bridge.config.model import Config
from bridge.reconnecting_clients import AGAIN, ReconnectingClients, clients_file
from bridge.routing.counters import Counters
from bridge.state_file import worker_folder
from yarp_compat.dev.release_trial import ReleaseTrials
from yarp_compat.dev.server import Server
from yarp_compat.dev.service import Service
from yarp_compat.naming import config as conf
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports.client_process import inspect_client
from yarp_compat.ports.commands import CommandWriter
from yarp_compat.ports.connections import AnyOutput, ConnectionEvent
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NamingConfigError, NoNameServerError
from yarp_compat.ports.port import PortCore
from yarp_compat.pythonic import Content, Received, payload_of
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.generation import Findings, Generation, GenerationDecision, Generations
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import begun_by_vocab

_log = logging.getLogger(__name__)

_ASK_SECONDS = 2.0
_COMMAND_SECONDS = 0.5
"""Time for which a reader may leave a velocity command unacknowledged, like the default ``timeout`` of a rule."""

Respond = Callable[[list[Any]], Content]
OnMessage = Callable[[Received], None]


class HostedPort:
    """A port of a module. Messages that are written before it is open are dropped."""

    def __init__(self, core: PortCore, answers: Generations | None = None) -> None:
        self.name = core.name  # as registered
        self.core = core
        self.answers = answers
        self.counters = Counters()
        self.trouble = "not opened yet"  # why the port is not open, "" if it is
        self._commands = CommandWriter(core, _COMMAND_SECONDS)

    @property
    def has_readers(self) -> bool:
        """Whether another port is connected to its output."""
        return bool(self.core.connections.outputs)

    def write(self, content: Content, envelope: str = "") -> int:
        """Send a message to all connected ports without waiting; return how many accepted it."""
        accepted: int = self.core.write(payload_of(content), envelope, strict=False)
        if accepted:
            self.counters.crossed(0)
        return accepted

    def write_command(self, content: Content, stop: Content, envelope: str = "") -> int:
        """Send a velocity command to the readers that can receive it now; return how many accepted it.

        ``stop``: the command that stops the robot, which follows commands that arrive late; see `CommandWriter`.
        """
        payload = payload_of(content)
        accepted = self._commands.write(payload, payload if content == stop else payload_of(stop), envelope)
        if accepted:
            self.counters.crossed(0)
        return accepted

    def write_by_release(self, make: Callable[[Generation], Content], envelope: str = "") -> int:
        """Send each reader what ``make`` returns for its YARP generation; the port must be an output ``by_release``."""
        readers: dict[Generation, set[AnyOutput]] = {}
        for output in self.core.connections.outputs:
            readers.setdefault(self._generation(output), set()).add(output)
        accepted = 0
        for generation, outputs in readers.items():
            payload = payload_of(make(generation))
            accepted += self.core.write(payload, envelope, strict=False, chosen=outputs.__contains__)
        if accepted:
            self.counters.crossed(0)
        return accepted

    def _generation(self, output: AnyOutput) -> Generation:
        decision = self._decision(output)
        cure = self._generations.hint(decision) if _is_device(output) else ""
        if cure:
            text = "%s: the YARP release of its reader %s is unknown (%s); sending it the data of %s; %s"
            _log.warning(text, self.name, decision.peer, decision.reason, decision.generation.value, cure)
        return decision.generation

    def _decision(self, output: AnyOutput) -> GenerationDecision:
        """Determine the YARP generation of a reader from its device and its process."""
        target, link = output.route.target, ("", 0)
        inspect_client(self._generations, target, output.profile, link, _far_end(output))
        return self._generations.of(target, output.profile, link)

    @property
    def _generations(self) -> Generations:
        if self.answers is None:
            raise TypeError(f"{self.name} was opened without by_release")
        return self.answers

    def status(self) -> dict[str, Any]:
        """Return the port's entry in the status document."""
        document = {"port": self.name, "state": "waiting" if self.trouble else "open", **self.counters.as_dict()}
        if self.trouble:
            document["error"] = self.trouble
        if self.answers is not None:
            for link in self.core.connections.inputs:
                inspect_client(self.answers, link.route.source, link.profile, link.address)
            document["peers"] = [
                {"port": i.route.source, "carrier": i.carrier.name}
                | self.answers.of(i.route.source, i.profile, i.address).as_dict()
                for i in self.core.connections.inputs
            ] + [
                {"port": output.route.target, "carrier": output.carrier.name} | self._decision(output).as_dict()
                for output in self.core.connections.outputs
                if _is_device(output)
            ]
        return document


def _is_device(output: AnyOutput) -> bool:
    """Return whether a reader is the stream of a YARP network client; other readers interpret the values themselves."""
    return output.route.target.endswith("/data:i")


def _far_end(output: AnyOutput) -> tuple[str, int] | None:
    try:
        host, number, *_ = output.sock.getpeername()
    except (OSError, ValueError):
        return None
    return str(host), int(number)


class _SwitchedOff(NameClient):
    """A name-server client for ``yarp.enabled: false``, whose commands all fail at once."""

    @property
    @override
    def address(self) -> Address:
        """Raise `NoNameServerError`."""
        raise NoNameServerError("YARP is switched off (yarp.enabled: false)")


class Ports:
    """The ports of one module. Callbacks of a port run on the threads of its connections, several at a time.

    Args:
        config: the configuration; its section ``yarp`` names the name server.
        findings: the findings on the clients' releases, shared by all modules of the process.

    Attributes:
        naming: the name-server client.
        generations: the YARP generation of each client of a served interface.
    """

    def __init__(self, config: Config, name: str, findings: Findings | None = None) -> None:
        self._config = config
        self._profile = Profile(config.yarp.profile)
        self.generations = config.yarp.generations(findings)
        self._off = config.yarp.enabled is False
        self.naming = (_SwitchedOff if self._off else NameClient)(
            _address(config), namespace=config.yarp.namespace, timeout=_ASK_SECONDS, numbers=config.yarp.numbers
        )
        self._trials = ReleaseTrials(self.generations, self.naming)
        self._ports: list[HostedPort] = []
        self._clients = ReconnectingClients(self.naming, clients_file(worker_folder(config), name))
        self._wake = threading.Event()
        self._closed = False
        self._thread: threading.Thread | None = None

    def serve(self, name: str, service: Service) -> HostedPort:
        """Offer an interface to YARP clients of every release."""
        server = Server(service, self.generations)

        def on_event(event: ConnectionEvent) -> None:
            server.on_event(event)
            if event.incoming and event.up:
                self._trials.connected(event.route.source, event.address)
            self._wake.set()

        port = self._make_port(name, server, is_output=False, rpc=True, on_event=on_event)
        port.answers = self.generations
        return self._open_soon(port)

    def respond(self, name: str, respond: Respond) -> HostedPort:
        """Answer Bottles of values, as the RPC ports of YARP modules do.

        If ``respond`` raises ValueError, WireError or TimeoutError, the answer is ``[fail]`` and the error's text.
        ``[many]``, ``[ok]`` and the like at the beginning of an answer are sent as vocabs; after ``[many]``, `yarp rpc`
        shows each text on its own line.
        """

        def on_request(message: PortMessage) -> None:
            received = Received(message, self._profile)
            try:
                answer = respond(received.values)
            except (ValueError, WireError, TimeoutError) as err:  # TimeoutError: the module's thread is busy
                answer = ["[fail]", str(err)]
            if message.wants_reply:
                received.reply(answer if isinstance(answer, Portable) else begun_by_vocab(answer))

        return self._open_soon(self._make_port(name, on_request, rpc=True, on_event=lambda _event: self._wake.set()))

    def input(self, name: str, on_message: OnMessage) -> HostedPort:
        """Receive the messages that YARP programs write to a port."""

        def on_port_message(message: PortMessage) -> None:
            port.counters.crossed(len(message.payload))
            try:
                on_message(Received(message, self._profile))
            except (WireError, TimeoutError) as err:
                port.counters.dropped("bad" if isinstance(err, WireError) else "queue")
                if port.counters.failed(str(err)):
                    _log.warning("%s: message refused: %s", name, err)

        port = self._make_port(name, on_port_message, is_output=False)
        return self._open_soon(port)

    def output(self, name: str, type_name: str = "", *, by_release: bool = False) -> HostedPort:
        """Open a port that writes to all connected ports; ``by_release``: to each in the form for its YARP release."""
        if not by_release:
            return self._open_soon(self._make_port(name, None, is_input=False, type_name=type_name))

        def on_event(event: ConnectionEvent) -> None:
            if not event.incoming:
                self.generations.forget(event.route.target)
            if not event.incoming and event.up:
                self._trials.connected(event.route.target, ("", 0))

        port = self._make_port(name, None, is_input=False, type_name=type_name, on_event=on_event)
        port.answers = self.generations
        return self._open_soon(port)

    def status(self) -> list[dict[str, Any]]:
        """Return all ports' entries in the status document."""
        return [] if self._off else [port.status() for port in self._ports]

    def tick(self) -> None:
        """Update the rates; called once a second."""
        for port in self._ports:
            port.counters.tick()

    def trouble(self) -> str:
        """Return why a port is not open; "" if all are open, or if YARP is not used here."""
        trouble = next((f"{port.name}: {port.trouble}" for port in self._ports if port.trouble), "")
        return "" if trouble and self._is_unused() else trouble

    def _is_unused(self) -> bool:
        """Return whether YARP is switched off, or neither the configuration nor a yarp.conf names a name server."""
        section = self._config.yarp
        if self._off or section.enabled is True or section.configured:
            return self._off
        try:
            return conf.read(section.namespace) is None
        except NamingConfigError:
            return False

    def close(self) -> None:
        self._closed = True
        self._trials.close()
        for port in self._ports:
            self._clients.unwatch(port.core)
        self._wake.set()
        if self._thread is not None:
            self._thread.join(_ASK_SECONDS + 0.5)
        for port in self._ports:
            port.core.close()
        self._ports = []

    def _make_port(self, name: str, on_message: Callable[[PortMessage], Any] | None, **options: Any) -> HostedPort:
        core = PortCore(
            name,
            on_message=on_message,
            naming=self.naming,
            profile=self._profile,
            limit=self._config.limits.message_bytes,
            host=self._config.yarp.ip,
            **options,
        )
        return HostedPort(core)

    def _open_soon(self, port: HostedPort) -> HostedPort:
        """Let the thread open a port; from then on it may receive messages."""
        self._ports.append(port)
        if self._off:
            return port
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="midspan-ports", daemon=True)
            self._thread.start()
        self._wake.set()
        return port

    def _run(self) -> None:
        while True:
            self._wake.clear()
            if self._closed:  # checked after the event is cleared, because `close` sets the event last
                return
            waiting = [port for port in list(self._ports) if port.trouble]
            for port in waiting:
                if self._closed:
                    return
                self._open(port)
            missing = self._clients.update()
            self._wake.wait(AGAIN if missing or any(port.trouble for port in self._ports) else None)

    def _open(self, port: HostedPort) -> None:
        try:
            port.core.open()
        except OSError as err:
            if str(err) != port.trouble:
                _log.info("%s cannot be opened yet: %s", port.name, err)
            port.trouble = str(err) or type(err).__name__
        except Exception as err:
            _log.exception("%s cannot be opened", port.name)
            port.trouble = f"{type(err).__name__}: {err}"
        else:
            port.trouble = ""
            if port.core.rpc:
                self._clients.watch(port.core)


def ports_stay(config: Config, old: Config) -> bool:
    """Return whether ports that were opened with the old configuration are also valid for the new one."""
    switched = (config.yarp.enabled is False) != (old.yarp.enabled is False)
    return not switched and config.yarp.opens_as(old.yarp)


def _address(config: Config) -> Address | None:
    place = config.yarp.place
    return None if place is None else Address(*place)
