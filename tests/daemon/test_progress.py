"""Who moves and who stands still, by figures."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from bridge.progress import Movement


def at_a_step(now: float, share: float, reads: bool) -> tuple[str, float, int]:
    return "importing", share * now, int(now) if reads else 0


@pytest.mark.parametrize(
    ("share", "reads", "moves"),
    [
        (1.0, False, True),
        (0.02, False, True),  # beside fifty others on its core
        (0.003, False, False),  # a wait that polls
        (0.0, False, False),
        (0.0, True, True),  # a slow disk
    ],
)
def test_who_computes_or_reads_moves(share: float, reads: bool, moves: bool) -> None:
    movement = Movement(0.0)
    for half in range(1, 241):
        movement.look(half / 2, *at_a_step(half / 2, share, reads))
    assert movement.still(120.0) == (0.0 if moves else 119.5)


def heartbeat(movement: Movement) -> None:
    movement.move(50.0)


def another_step(movement: Movement) -> None:
    movement.look(50.0, "another", 7.0)


@pytest.mark.parametrize("moves", [heartbeat, another_step])
def test_a_heartbeat_and_another_step_are_moves_and_begin_anew(moves: Callable[[Movement], None]) -> None:
    movement = Movement(0.0)
    movement.look(1.0, "one", 2.0)
    movement.look(2.0, "one", 7.0)
    assert movement.computed() == 5.0
    moves(movement)
    assert movement.still(51.0) == 1.0
    assert movement.computed() == 0.0
