"""Writes locations into a store, and prints each one's number once the store has acknowledged it."""

from __future__ import annotations

import sys
from pathlib import Path

from bridge.stores.kinds import LOCATION
from bridge.stores.replica import Replica
from bridge.stores.store import Store
from yarp_compat.dev.locations import Map2DLocation

file, first, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
store = Store(Replica(file, "writer"))
for number in range(first, first + count):
    store.put(LOCATION, f"l{number % 400}", Map2DLocation("m1", float(number), description="d" * 500))
    print(number, flush=True)
