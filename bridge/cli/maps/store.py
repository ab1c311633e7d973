"""How a verb joins the store: the daemon's own copy, else another's, over the hub."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from bridge.cli.client import CliClient, open_client
from bridge.cli.output import CliError, near
from bridge.stores.client import StoreClient
from bridge.stores.kinds import MAP
from bridge.stores.wire import prefix
from yarp_compat.dev.mapgrid import MapGrid2D


@contextmanager
def open_stored(args: argparse.Namespace) -> Iterator[tuple[CliClient, StoreClient]]:
    """Join the hub and find a store; raises `CliError` or `StoreError` where there is none."""
    with open_client(args) as client:
        space = client.hub.keyspace(prefix(client.config.hub.domain))
        yield client, StoreClient(space, client.config.name)


def named_map(stored: StoreClient, name: str | None) -> MapGrid2D:
    """A map by its name, or the one that is in use; raises `CliError`."""
    wanted = name or stored.current_map()
    if not wanted:
        raise CliError("no map is in use: give a name, or choose one with 'midspan map use NAME'")
    found = stored.get(MAP, wanted)
    if found is None:
        raise CliError(missing("map", wanted, stored.names(MAP)))
    return found


def missing(kind: str, name: str, names: list[str]) -> str:
    """That there is no such, with the names that may have been meant."""
    meant = near(name, names) or names[:10]
    return f"there is no {kind} {name!r}; " + (f"there is {', '.join(meant)}" if meant else "there is none at all")
