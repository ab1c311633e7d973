"""All orders of faults and requests against a simulated planner and base: no word may contradict the base."""

from __future__ import annotations

import pytest

from tests.navigation.gateway import world


@pytest.mark.parametrize("seed", range(150))
def test_no_word_contradicts_the_base(seed: int) -> None:
    world.run(seed)
