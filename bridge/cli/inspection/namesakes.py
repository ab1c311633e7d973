"""Answers of daemons with one name, with distinct names."""

from __future__ import annotations

from collections.abc import Sequence

from bridge.cli.client import CliClient
from bridge.daemon import units
from bridge.hub.control import WorkerAnswer
from bridge.hub.daemons import identity_of
from bridge.hub.namesakes import DaemonNames


def daemon_names(client: CliClient, status: Sequence[WorkerAnswer]) -> DaemonNames:
    """Return the names of the hub's daemons; ``status`` are all answers to ``status``, or those of the routers."""
    config = client.config
    places = [config] if config.state else [config, config.model_copy(update={"state": units.STATE})]
    own = [identity.instance for place in places if (identity := identity_of(place)) is not None]
    return DaemonNames(status, client.hub.zid, own if client.here else ())


def distinct(client: CliClient, status: Sequence[WorkerAnswer]) -> list[WorkerAnswer]:
    """Return all answers to ``status`` with distinct names of their daemons."""
    return daemon_names(client, status).apply(status)
