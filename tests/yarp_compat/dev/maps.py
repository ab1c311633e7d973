"""Generated maps."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

from yarp_compat.dev.mapflag import UNKNOWN, MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

METERS = st.floats(-1e4, 1e4, allow_subnormal=False)


@st.composite
def maps(draw: Any, *, rotated: bool = True) -> MapGrid2D:
    """A map with consistent cells: walls have an occupancy of 50 or more, free cells below 50, unknown ones UNKNOWN."""
    shape = draw(st.tuples(st.integers(1, 12), st.integers(1, 12)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    flags = rng.integers(0, 6, shape, dtype=np.uint8)
    occupancy = rng.integers(0, 102, shape).astype(np.uint8)
    occupancy[occupancy == 101] = UNKNOWN
    occupancy = np.where(flags == MapFlag.FREE, rng.integers(0, 50, shape), occupancy)
    occupancy = np.where(flags == MapFlag.WALL, rng.integers(50, 101, shape), occupancy)
    occupancy = np.where(flags == MapFlag.UNKNOWN, UNKNOWN, occupancy)
    return MapGrid2D.of(
        flags, occupancy,
        name=draw(st.sampled_from(["m1", "first floor", 'a "b"', "piano 1°", "12"])),
        resolution=draw(st.sampled_from([0.05, 0.1, 1.0, 0.024999, 1e-5, 7.0])),
        origin=(draw(METERS), draw(METERS), draw(st.floats(-180, 180)) if rotated else 0.0),
    )  # fmt: skip
