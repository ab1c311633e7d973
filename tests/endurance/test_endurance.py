"""Some hundred endpoints made and destroyed on each side, and a slow subscriber on each; longer runs by benchmarks."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from benchmarks import churn, slow_consumer
from benchmarks.endurance.deployment import SIDES, Census, Deployment
from benchmarks.latency.usage import WORKERS
from tests.support.wait import until

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

BATCHES = 2
MOST_EACH = 60_000
"""Bytes of memory that an endpoint may leave: zenoh keeps up to 15 kB for its keys, and a short run is uneven."""

ROUNDS = 4
"""Of so many rounds one must leave as little: what waits in queues on a busy machine grows no further, a leak does."""

SPARE_THREADS = 8
"""Threads that the middlewares start once and keep."""


@pytest.fixture(scope="module")
def deployment() -> Iterator[Deployment]:
    """A daemon between a program of each side."""
    with Deployment() as made:
        for side in SIDES:
            made.program(side)
        yield made


@pytest.mark.timeout(300)
def test_endpoints_that_come_and_go_leave_nothing(deployment: Deployment):
    churns = [churn.Churn(deployment, side) for side in SIDES]
    # What is made once is made for the first batch.
    for one in churns:
        one.batch()
    first = before = settled(deployment, None)
    grown: dict[str, list[float]] = {name: [] for name in before.used}
    for _ in range(ROUNDS):
        for one in churns:
            for _ in range(BATCHES):
                one.batch()
        after = settled(deployment, first)
        for name, used in before.used.items():
            each = (after.used[name].rss - used.rss) * 1e6 / (len(SIDES) * BATCHES * churn.BATCH)
            grown[name].append(round(each))
            assert after.used[name].threads <= first.used[name].threads + SPARE_THREADS, name
            assert after.used[name].descriptors <= first.used[name].descriptors + SPARE_THREADS, name
        if all(min(rounds) < MOST_EACH for rounds in grown.values()):
            return
        before = after
    raise AssertionError(f"bytes for each endpoint, round by round: {grown}")


def settled(deployment: Deployment, before: Census | None) -> Census:
    """The daemon once only the feeds are left; idle threads go ten seconds later."""
    feeds = len(SIDES) * (churn.FED + churn.STREAMED)
    last: list[tuple[int, int]] = []

    def left() -> Census | None:
        own = sum(deployment.routes("/churn").values()) + sum(deployment.routes("/kept").values())
        census = deployment.census()
        last.append((census.tokens, census.registrations))
        stands = last[-2:] == [last[-1]] * 2  # tokens and registrations go a moment after the routes
        idle = (
            stands
            if before is None
            else (
                last[-1] == (before.tokens, before.registrations)
                and all(census.used[w].threads <= before.used[w].threads + SPARE_THREADS for w in WORKERS)
            )
        )
        return census if not own and idle and sum(census.routes.values()) >= feeds else None

    try:
        return until(left, "nothing is left of the endpoints", 40, every=0.5)
    except AssertionError:
        print(before, deployment.census(), deployment.routes("/churn"), deployment.routes("/kept"), sep="\n")
        raise


@pytest.mark.parametrize("side", SIDES)
def test_a_slow_subscriber_costs_bounded_memory_and_delays_nobody(deployment: Deployment, side: str) -> None:
    """A message a second of 40 MB/s; one side at a time: two cores carry no three such streams."""
    (slow,) = slow_consumer.measure(deployment, [side], rate=40.0, seconds=4.0, alone=1.0)
    small, big = slow.beside[slow_consumer.SMALL], slow.beside[slow_consumer.BIG]
    assert slow.read < 15, "it is slow"
    assert small.sent > 100
    assert (small.repeated, big.repeated) == (0, 0)
    if (
        side == "zenoh"
    ):  # a link drops what a slow reader leaves in it, and large messages wait for it (docs/sides/hub.md)
        assert small.lost <= small.sent // 50
    else:
        assert small.lost == 0
        assert big.lost < big.sent / 10
    for name, most in slow.memory_beside.items():
        assert most - slow.memory_before[name] < 100, f"{name}: the slow one cost {most} MB"
    if side == "ros1":
        assert slow.drops["slow"] > 0
