"""Collects the input of the checks, in a program that has already joined the hub."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

from bridge.client.session import Client
from bridge.client.status import answered
from bridge.config.document import ConfigError
from bridge.config.load import find, load
from bridge.config.model import Config
from bridge.doctor import context
from bridge.doctor.context import CheckContext, HubSnapshot
from bridge.doctor.daemon_state import DaemonState, absent, daemon_state, unanswered, with_restarts, with_silent

_CLOCK_SECONDS = 0.5
_MAX_CLOCKS = 50


def context_from(client: Client, file: Path | None) -> CheckContext:
    """Return what the checks examine, for a program of the daemon that is on the hub; ``file``: the configuration."""
    return make_context(client.config, snapshot(client), daemon_state(client.config, file=file), file)


def make_context(config: Config, hub: HubSnapshot, state: DaemonState, file: Path | None) -> CheckContext:
    """Return what the checks examine, with the workers that only their daemon reports."""
    documents = with_silent(hub.documents, absent(state.document, looping=True))
    if not hub.error:
        documents += unanswered(state.document, documents)
    hub = dataclasses.replace(hub, documents=with_restarts(documents, state.document))
    text, good = check_file(file)
    return CheckContext(config, text, config_good=good, environ=dict(os.environ), hub=hub, daemon=state)


def check_file(file: Path | None) -> tuple[str, bool]:
    """Check a configuration file, by default the one that `find` returns; return a text, and whether it is valid."""
    try:
        load(file)
    except ConfigError as err:
        return str(err), False
    file = file or find()
    return (f"{file} is valid" if file is not None else "no configuration file: all defaults"), True


def snapshot(client: Client) -> HubSnapshot:
    """Return the hub as this client sees it."""
    documents = answered(client)
    client.settle()
    return HubSnapshot("", documents, client.endpoints(), _clocks(client))


def _clocks(client: Client) -> dict[str, context.Offset]:
    offsets: dict[str, context.Offset] = {}
    for answer in client.ask("time", timeout=_CLOCK_SECONDS)[:_MAX_CLOCKS]:
        if not answer.error:
            offset = context.measure(lambda to=answer: _time(client, to.daemon, to.worker))  # type: ignore[misc]
            if offset is not None:
                offsets[f"{answer.daemon}/{answer.worker}"] = offset
    return offsets


def _time(client: Client, daemon: str, worker: str) -> int | None:
    for answer in client.hub.ask("time", {}, daemon, worker, _CLOCK_SECONDS):
        match answer.value:
            case {"time_ns": int(time_ns)}:
                return time_ns
    return None
