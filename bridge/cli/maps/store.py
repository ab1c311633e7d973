"""A verb's access to the store over the hub: the copy of the configured daemon, else that of another."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from bridge.cli.client import CliClient, open_client
from bridge.cli.output import CliError, near
from bridge.stores.client import StoreClient
from bridge.stores.entry import StoreError
from bridge.stores.kinds import MAP
from bridge.stores.wire import prefix
from yarp_compat.dev.mapgrid import MapGrid2D


@contextmanager
def open_stored(args: argparse.Namespace) -> Iterator[tuple[CliClient, StoreClient]]:
    """Join the hub and find a store; raises `CliError` or `StoreError` without one."""
    with open_client(args) as client:
        space = client.hub.keyspace(prefix(client.config.hub.domain))
        try:
            stored = StoreClient(space, client.config.name)
        except StoreError as err:
            raise CliError(no_store(client, str(err))) from None
        yield client, stored


def no_store(client: CliClient, trouble: str) -> str:
    """Return why no daemon on the hub has a store; ``trouble`` if the reason is not on this machine."""
    missing = client.daemon().why_missing("modules", client.config)
    return f"no store answers: {missing}" if missing else trouble


def named_map(stored: StoreClient, name: str | None) -> MapGrid2D:
    """Return a map by its name, by default the one in use; raises `CliError`."""
    wanted = name or stored.current_map()
    if not wanted:
        raise CliError("no map is in use: give a name, or choose one with 'midspan map use NAME'")
    grid = stored.get(MAP, wanted)
    if grid is None:
        raise CliError(missing("map", wanted, stored.names(MAP)))
    return grid


def missing(kind: str, name: str, names: list[str]) -> str:
    """Return the error for a missing value, with similar names."""
    meant = near(name, names) or names[:10]
    others = f"those that are: {', '.join(meant)}" if meant else "the store has none"
    return f"no {kind} {name!r} is stored; {others}"
