"""A command's access to the store over the hub: to the configured daemon's copy, or else to another daemon's."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from bridge.cli.client import CliClient, open_client
from bridge.cli.output import CliError
from bridge.client.store import StoreClient, open_store
from bridge.stores.entry import StoreError
from bridge.stores.kinds import MAP
from bridge.text import near
from yarp_compat.dev.mapgrid import MapGrid2D


@contextmanager
def open_stored(args: argparse.Namespace) -> Iterator[tuple[CliClient, StoreClient]]:
    """Join the hub and find a store; raises `CliError` or `StoreError` if either is missing."""
    with open_client(args) as client:
        yield client, store_of(client)


def store_of(client: CliClient) -> StoreClient:
    """Find the store of the configured daemon, or of another one; raises `CliError` with the reason if none exists."""
    try:
        return open_store(client)
    except StoreError as err:
        missing = client.daemon().why_missing("modules", client.config)
        raise CliError(f"no store answers: {missing}" if missing else str(err)) from None


def named_map(stored: StoreClient, name: str | None) -> MapGrid2D:
    """Return a map by its name, by default the one in use; raises `CliError` if the store does not have it."""
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
