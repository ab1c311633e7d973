"""How a verb joins the hub: as a zenoh client of the router, for as long as the verb runs."""

from __future__ import annotations

import argparse
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import zenoh

from bridge.cli.output import CliError
from bridge.config.load import load
from bridge.config.model import Config
from bridge.hub.control import WorkerAnswer
from bridge.hub.errors import HubError
from bridge.hub.session import Hub, HubSession, HubSettings
from bridge.hub.zenoh_config import client_session_config, connect_endpoint

if TYPE_CHECKING:
    from bridge.messages.registry import Registry


CONNECT_SECONDS = 2.0
ASK_SECONDS = 2.0
_QUIET = 0.1
_SETTLE_SECONDS = 1.5


@dataclass(frozen=True, slots=True)
class CliClient:
    """A verb's session on the hub, its configuration, and in words which hub it is (``where``)."""

    hub: Hub
    config: Config
    where: str

    def ask(
        self, verb: str, params: dict[str, Any] | None = None, *, worker: str = "*", timeout: float = ASK_SECONDS
    ) -> list[WorkerAnswer]:
        """Ask all workers on the hub, or those of one name; in the order of daemons and workers."""
        answers = self.hub.ask(verb, params or {}, worker=worker, timeout=timeout)
        return sorted(answers, key=lambda a: (a.daemon, a.worker))

    def registry(self) -> Registry:
        """The message types known here, by the configuration's folders and rules."""
        from bridge.messages.registry import Registry  # many verbs need no types

        return Registry.of(self.config.types)

    def catch_up(self) -> None:
        """Wait until what the router knows of the hub's graph is known here."""
        self.hub.graph.catch_up(_SETTLE_SECONDS)

    def settle(self) -> None:
        """Wait until the hub's graph is known here: all that the router knew, and nothing new for a moment."""
        self.catch_up()
        changed = threading.Event()
        close = self.hub.graph.watch(changed.set)
        end = time.monotonic() + _SETTLE_SECONDS
        try:
            while changed.wait(_QUIET) and time.monotonic() < end:
                changed.clear()
        finally:
            close()


def client_config(args: argparse.Namespace) -> Config:
    """The configuration with what the command line says laid over it."""
    config = load(args.config)
    hub = config.hub
    if args.router is not None:
        hub = hub.model_copy(update={"listen": args.router})
    if args.hub_domain is not None:
        hub = hub.model_copy(update={"domain": args.hub_domain})
    return config.model_copy(update={"hub": hub})


@contextmanager
def open_client(args: argparse.Namespace) -> Iterator[CliClient]:
    """Join the hub; raises `CliError` where no router answers."""
    with connect(client_config(args)) as client:
        yield client


@contextmanager
def connect(config: Config, seconds: float = CONNECT_SECONDS) -> Iterator[CliClient]:
    """Join the hub that a configuration names; raises `CliError` where no router answers within ``seconds``."""
    where = f"the hub at {connect_endpoint(config.hub.listen)} (domain {config.hub.domain})"
    try:
        session = zenoh.open(client_session_config(config.hub.listen, config.hub.zenoh, seconds))
    except zenoh.ZError as err:
        raise CliError(
            f"no zenoh router answers for {where}: {_short(err)}\n"
            "Is the daemon running? Start it with 'midspan run', or name another router with --router."
        ) from None
    except HubError as err:
        raise CliError(f"hub.zenoh: {err}") from None
    try:
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


def _short(err: zenoh.ZError) -> str:
    """The words of zenoh itself, without the places in its source."""
    return str(err).partition(" at /")[0].rstrip(".!")
