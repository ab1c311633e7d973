"""A verb's session on the hub: a zenoh client of the router while the verb runs."""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zenoh

from bridge.cli.output import CliError
from bridge.config.document import ConfigError
from bridge.config.load import find, load
from bridge.config.model import Config
from bridge.config.sections.section import is_loopback
from bridge.daemon import units
from bridge.doctor.daemon_state import DaemonState, Life, daemon_state, describe, unresponsive_router
from bridge.hub.control import WorkerAnswer
from bridge.hub.errors import HubError
from bridge.hub.identity import ask_identity
from bridge.hub.session import Hub, HubSession, HubSettings
from bridge.hub.zenoh_config import client_session_config, connect_endpoint
from bridge.state_file import named
from bridge.stores.entry import StoreError

if TYPE_CHECKING:
    from bridge.messages.registry import Registry


CONNECT_SECONDS = 2.0
ASK_SECONDS = 2.0
_QUIET = 0.1
_SETTLE_SECONDS = 1.5


class UnreachableHubError(CliError):
    """No router answers at the hub's endpoint; ``hint`` names the likely cause and the cure."""

    def __init__(self, text: str, hint: str) -> None:
        super().__init__(f"{text}\n{hint}")
        self.text, self.hint = text, hint


@dataclass(frozen=True, slots=True)
class CliClient:
    """A verb's session on the hub.

    Attributes:
        where: the hub's name for messages.
        here: whether the hub is that of this machine's daemon.
        file: the configuration's file.
    """

    hub: Hub
    config: Config
    where: str
    here: bool = True
    file: Path | None = None

    def daemon(self, documents: Iterable[Mapping[str, Any]] = ()) -> DaemonState:
        """Return the state of this machine's daemon, unknown on another hub; the documents are those of the hub."""
        return daemon_state(self.config, documents, self.file) if self.here else DaemonState(self.config.name)

    def ask(
        self, verb: str, params: dict[str, Any] | None = None, *, worker: str = "*", timeout: float = ASK_SECONDS
    ) -> list[WorkerAnswer]:
        """Ask all workers on the hub, or those of one name; the answers are sorted by daemon and worker."""
        answers = self.hub.ask(verb, params or {}, worker=worker, timeout=timeout)
        return sorted(answers, key=lambda a: (a.daemon, a.worker))

    def registry(self) -> Registry:
        """Return the message types of the configuration's folders and rules."""
        from bridge.messages.registry import Registry  # many verbs need no types

        return Registry.of(self.config.types)

    def catch_up(self) -> None:
        """Wait until this session has received the hub's graph from the router."""
        self.hub.graph.catch_up(_SETTLE_SECONDS)

    def settle(self) -> None:
        """Wait until this session has received the hub's graph, and the graph has not changed for a moment."""
        self.catch_up()
        changed = threading.Event()
        close = self.hub.graph.watch(changed.set)
        end = time.monotonic() + _SETTLE_SECONDS
        try:
            while changed.wait(_QUIET) and time.monotonic() < end:
                changed.clear()
        finally:
            close()


def config_file(args: argparse.Namespace) -> Path | None:
    """Return the configuration file that a verb uses, or None."""
    file: Path | None = args.config or find()
    return file


def client_config(args: argparse.Namespace) -> Config:
    """Return the configuration, overridden by the command line.

    A broken file that the command line does not name is ignored, with a warning, if ``--router`` names the hub.
    """
    try:
        config = named(load(args.config), os.environ, units.STATE)
    except ConfigError as err:
        if args.config is not None or args.router is None:
            raise
        more = f" (and {len(err.problems) - 1} more)" if len(err.problems) > 1 else ""
        ignored = "the file is ignored, as --router names the hub"
        print(f"midspan: warning: {err.problems[0]}{more}; {ignored}", file=sys.stderr)
        config = Config()
    hub = config.hub
    if args.router is not None:
        hub = hub.model_copy(update={"listen": args.router})
    if args.hub_domain is not None:
        hub = hub.model_copy(update={"domain": args.hub_domain})
    return config.model_copy(update={"hub": hub})


@contextmanager
def open_client(args: argparse.Namespace, *, warn: bool = True, watches: bool = False) -> Iterator[CliClient]:
    """Join the hub; raises `CliError` if no router answers.

    A daemon that does not run although its router does is reported on stderr, and each error names the daemon's
    workers that do not run; both only for the hub of this machine's daemon. ``warn`` is False for verbs that report the
    daemon themselves, or have something more urgent to do. ``watches`` reports missing workers at once, for verbs that
    would only wait or print less.
    """
    config = client_config(args)
    with _connected(args, config) as client:
        client = replace(client, here=of_this_machine(args), file=config_file(args))
        reported = warn_of_daemon(args, config, workers=watches) if warn else []
        try:
            yield client
        except (CliError, StoreError) as err:
            absences = client.daemon().absences()
            absences = [line for line in absences if line not in (*reported, str(err)) and line not in str(err)]
            if not absences:
                raise
            raise CliError("\n".join([str(err), *absences])) from None


@contextmanager
def _connected(args: argparse.Namespace, config: Config) -> Iterator[CliClient]:
    """Join the hub; the error names what this machine's daemon knows of its router."""
    with ExitStack() as stack:
        try:
            client = stack.enter_context(connect(config, here=of_this_machine(args)))
        except UnreachableHubError as err:
            state = daemon_state(config, file=config_file(args)) if of_this_machine(args) else DaemonState("")
            missing = state.why_missing("router", config) or _report(state)
            if not missing:
                raise
            hint = "" if err.hint == _DOWN or (_HELD in err.hint and "is held by" in missing) else err.hint
            raise CliError("\n".join(filter(None, (err.text, missing, state.cure, hint)))) from None
        yield client


def _report(state: DaemonState) -> str:
    """Return how the router of a running daemon gets on; "" if the daemon does not run."""
    if state.life is not Life.RUNNING:
        return ""
    (router,) = [worker for worker in state.workers if worker["worker"] == "router"] or [{"phase": "missing"}]
    how = ": ".join(filter(None, (router["phase"], describe(router))))
    return f"the daemon {state.name} is running (process {state.pid}); its worker 'router' is {how}"


def warn_of_daemon(args: argparse.Namespace, config: Config, *, workers: bool = True) -> list[str]:
    """Report on stderr that this machine's daemon, or some of its workers, do not run; returns the lines."""
    if not of_this_machine(args):
        return []
    state = daemon_state(config, file=config_file(args))
    lines = [f"{state.trouble}; {state.cure}"] if state.trouble else []
    lines += state.absences() if workers else []
    for line in lines:
        print(f"midspan: warning: {line}", file=sys.stderr)
    return lines


def of_this_machine(args: argparse.Namespace) -> bool:
    """Whether the command line names no other hub than that of this machine's daemon."""
    return args.router is None and args.hub_domain is None


@contextmanager
def connect(config: Config, seconds: float = CONNECT_SECONDS, *, here: bool = False) -> Iterator[CliClient]:
    """Join the hub of a configuration; raises `CliError` if no router answers within ``seconds``.

    ``here``: the hub is that of this machine's daemon, whose name the client gets if it is not known.
    """
    where = f"the hub at {connect_endpoint(config.hub.listen)} (domain {config.hub.domain})"
    try:
        session = zenoh.open(client_session_config(config.hub.listen, config.hub.zenoh, seconds))
    except zenoh.ZError as err:
        text = f"no zenoh router answers for {where}: {_short(err)}"
        raise UnreachableHubError(text, _hint(config)) from None
    except HubError as err:
        raise CliError(f"hub.zenoh: {err}") from None
    try:
        config = _with_name(config, session) if here else config
        settings = HubSettings(
            domain=config.hub.domain, node=f"midspan_cli_{os.getpid()}", daemon=config.name, worker=f"cli-{os.getpid()}"
        )
        hub = Hub(HubSession(session, settings), settings)
    except BaseException:
        session.close()  # type: ignore[no-untyped-call]
        raise
    try:
        yield CliClient(hub, config, where)
    finally:
        hub.close()


def _with_name(config: Config, session: zenoh.Session) -> Config:
    """Return the configuration with the name of the router's daemon, if neither the file nor the state has one.

    The state folder of a service is not readable for other users, and the machine may have been renamed.
    """
    if "name" not in config.model_fields_set and is_loopback(config.hub.listen):
        for zid in session.info.routers_zid():
            daemon, _ = ask_identity(session, str(zid), ASK_SECONDS)
            if daemon:
                return config.model_copy(update={"name": daemon})
    return config


_DOWN = "Is the daemon running? Start it with 'midspan run', or name another router with --router."
_HELD = "Another program holds"


def _hint(config: Config) -> str:
    """Return why no router may answer at the hub's endpoint, and what to do."""
    from bridge.hub.router import port_held  # needed only here

    endpoint = config.hub.listen
    unresponsive = unresponsive_router(config)
    if unresponsive:
        return f"{unresponsive}; 'midspan doctor' names the cause, and its log may, too"
    if not port_held(endpoint):
        return _DOWN
    place = connect_endpoint(endpoint)
    tls = ", or it refuses this machine's certificate" if place.startswith(("tls/", "quic/")) else ""
    cure = "Stop it, set hub.listen to a free port, or name another router with --router."
    return f"{_HELD} {place}: it is not a zenoh router{tls}. {cure}"


def _short(err: zenoh.ZError) -> str:
    """Return zenoh's message without the location in its source code."""
    return str(err).partition(" at /")[0].rstrip(".!")
