"""Stores in the tests' own folders."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bridge.stores.replica import Replica, StoreLimits
from bridge.stores.store import Store

Make = Callable[..., Store]


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Make]:
    """Return a function that opens the store of a name; all are closed at the end."""
    opened: list[Store] = []

    def open_store(name: str = "one", limits: StoreLimits | None = None) -> Store:
        store = Store(Replica(tmp_path / f"{name}.sqlite", name, limits))
        opened.append(store)
        return store

    yield open_store
    for store in opened:
        store.replica.close()


@pytest.fixture
def store(make: Make) -> Store:
    """Return one store."""
    return make()
