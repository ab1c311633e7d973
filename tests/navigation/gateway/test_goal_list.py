"""Goals from a server's list: no list does not mean "no goals", and a list is valid while its publisher exists."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bridge.messages.actions import GoalState
from navigation.gateway import goal_list
from navigation.gateway.goal_list import EARLY_SECONDS, EMPTY_SECONDS, GoalList
from tests.peers.navigation.simulated_hub import Clock

SERVER, OTHER = b"server", b"other"
GOAL, NEXT = b"first goal", b"second goal"
DRIVING, ENDED = {GOAL: GoalState.EXECUTING}, {GOAL: GoalState.SUCCEEDED}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[Clock]:
    clock = Clock()
    monkeypatch.setattr(goal_list, "time", clock)
    return clock


def later(clock: Clock, goals: GoalList, seconds: float, *publishers: bytes) -> None:
    """Refresh ten times a second, as the gateway does, with these publishers in the graph."""
    end = clock.now + seconds
    while clock.now < end:
        clock.now = min(clock.now + 0.1, end)
        goals.refresh(publishers)


@pytest.mark.parametrize("always", [True, False])
def test_goals_are_unknown_before_the_first_list(clock: Clock, always: bool) -> None:
    goals = GoalList(always=always)
    assert not goals.known
    later(clock, goals, 100.0)
    assert not goals.known, "without a publisher, goals are unknown"
    later(clock, goals, EMPTY_SECONDS - 0.5, SERVER)
    assert not goals.known
    assert not goals.any
    assert goals.receive(SERVER, DRIVING)
    assert goals.known
    assert goals.any
    assert goals.active == (GOAL,)


def test_a_server_that_always_publishes_its_list_has_unknown_goals_until_then(clock: Clock) -> None:
    goals = GoalList(always=True)
    later(clock, goals, 600.0, SERVER)
    assert not goals.known
    assert not goals.any
    goals.receive(SERVER, {})
    assert goals.known
    assert goals.active == ()


def test_a_server_of_rcl_without_a_list_has_no_goals(clock: Clock) -> None:
    """An rcl server publishes its first list with its first goal."""
    goals = GoalList(always=False)
    later(clock, goals, 0.1, SERVER)
    later(clock, goals, EMPTY_SECONDS - 0.2, SERVER)
    assert not goals.known
    later(clock, goals, 0.4, SERVER)
    assert goals.known
    assert goals.any
    assert goals.active == ()


def test_a_stall_of_this_process_does_not_count_as_time_without_a_list(clock: Clock) -> None:
    """The list may have arrived during the stall, and is read after the server's publishers are refreshed."""
    goals = GoalList(always=False)
    later(clock, goals, 0.5, SERVER)
    clock.now += EMPTY_SECONDS
    goals.refresh((SERVER,))
    assert not goals.known
    assert goals.receive(SERVER, DRIVING)
    assert goals.active == (GOAL,)


def test_a_new_server_of_rcl_gets_its_own_time_to_publish_a_list(clock: Clock) -> None:
    """The list of the previous server does not apply to the new one, and is dropped after a while."""
    goals = GoalList(always=False)
    goals.receive(SERVER, DRIVING)
    later(clock, goals, 5.0, SERVER)
    later(clock, goals, 1.0)
    later(clock, goals, EMPTY_SECONDS - 0.2, OTHER)
    assert not goals.known
    assert goals.active == (GOAL,), "the previous server's goals are kept, but marked as invalid"
    later(clock, goals, 0.5, OTHER)
    assert goals.known
    assert goals.active == ()


@pytest.mark.parametrize("always", [True, False])
def test_the_list_of_a_dead_publisher_is_invalid(clock: Clock, always: bool) -> None:
    goals = GoalList(always=always)
    goals.receive(SERVER, DRIVING)
    later(clock, goals, 60.0, SERVER)
    assert goals.known, "a list does not age while its publisher exists"
    goals.refresh(())
    assert not goals.known
    assert goals.active == (GOAL,)
    assert goals.status(GOAL) is GoalState.EXECUTING
    later(clock, goals, 60.0)
    assert not goals.known, "silence does not make the list valid again"
    goals.refresh((SERVER,))
    assert goals.known, "the publisher's token was lost for a moment, but the list was not"


def test_another_publisher_does_not_make_the_list_of_a_dead_publisher_valid(clock: Clock) -> None:
    goals = GoalList(always=True)
    goals.receive(SERVER, {})
    later(clock, goals, 5.0, SERVER, OTHER)
    assert goals.known
    goals.refresh((OTHER,))
    assert not goals.known
    goals.receive(OTHER, DRIVING)
    goals.refresh((OTHER,))
    assert goals.known
    assert goals.active == (GOAL,)


@pytest.mark.parametrize("always", [True, False])
def test_a_list_may_be_ahead_of_the_graph_for_a_moment(clock: Clock, always: bool) -> None:
    """A new worker's list arrives while the graph still shows the publisher of the worker that was killed."""
    goals = GoalList(always=always)
    goals.receive(OTHER, {})
    later(clock, goals, 5.0, OTHER)
    goals.receive(SERVER, DRIVING)
    later(clock, goals, EARLY_SECONDS - 0.2, OTHER)
    assert goals.known
    assert goals.active == (GOAL,)
    later(clock, goals, 0.4, OTHER)
    assert not goals.known, "the list's publisher has not appeared"
    goals.refresh((OTHER, SERVER))
    assert goals.known


def test_a_list_from_a_publisher_that_has_just_left_is_not_ahead_of_the_graph(clock: Clock) -> None:
    """The last list of a killed worker arrives before its token is withdrawn, and becomes invalid at the withdrawal."""
    goals = GoalList(always=True)
    later(clock, goals, 1.0, SERVER, OTHER)
    goals.receive(SERVER, {})
    goals.refresh((SERVER, OTHER))
    goals.refresh((OTHER,))
    assert not goals.known


def test_a_new_server_gets_its_own_time_even_while_the_graph_still_shows_its_predecessor(clock: Clock) -> None:
    """A frozen worker's tokens remain until its lease expires; its successor has not published a list yet."""
    goals = GoalList(always=False)
    goals.receive(SERVER, DRIVING)
    later(clock, goals, 5.0, SERVER)
    later(clock, goals, 0.2, SERVER, OTHER)
    later(clock, goals, 0.2, OTHER)
    assert not goals.known, "0.4 s after the server appeared, it has not reported its goals"
    later(clock, goals, EMPTY_SECONDS, OTHER)
    assert goals.known
    assert goals.active == ()


def test_only_a_list_that_differs_is_a_change(clock: Clock) -> None:
    goals = GoalList(always=True)
    assert not goals.receive(SERVER, {})
    assert goals.receive(SERVER, DRIVING)
    assert not goals.receive(SERVER, DRIVING)
    assert goals.receive(SERVER, ENDED)
    assert goals.active == ()
    assert goals.status(GOAL) is GoalState.SUCCEEDED
    assert goals.receive(SERVER, {NEXT: GoalState.ACCEPTED})
    assert goals.active == (NEXT,)
    assert goals.status(GOAL) is None


def test_the_fresh_list_of_a_server_that_has_just_gone_does_not_apply_to_its_successor(clock: Clock) -> None:
    goals = GoalList(always=True)
    later(clock, goals, 0.1, SERVER)
    goals.receive(SERVER, DRIVING)
    later(clock, goals, 0.1)
    later(clock, goals, 0.1, OTHER)
    assert not goals.known, "the graph has shown the publisher of the list, so it is not merely late"
    goals.receive(OTHER, {})
    assert goals.known
    assert goals.active == ()
