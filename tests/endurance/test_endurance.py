"""Hundreds of endpoints are created and closed on each side, and each has a slow subscriber; benchmarks run longer."""

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
"""Memory in bytes that may remain per closed endpoint: zenoh retains up to 15 kB for its keys, and short runs vary."""

ROUNDS = 4
"""Maximum number of rounds, in one of which each process must stay within the limit: unlike leaks, queues on a busy
machine stop growing."""

SPARE_THREADS = 8
"""Number of threads that the middlewares start only once."""

SLOW_SECONDS = 3.0
"""Duration of the stream beside the slow subscriber: 120 MB, which an unbounded queue would hold."""


@pytest.fixture(scope="module")
def deployment() -> Iterator[Deployment]:
    """A daemon that bridges one program on each side."""
    with Deployment() as started:
        for side in SIDES:
            started.program(side)
        yield started


@pytest.mark.timeout(300)
def test_closed_endpoints_leave_no_memory_or_threads(deployment: Deployment):
    churns = [churn.Churn(deployment, side) for side in SIDES]
    # the first batch creates what is created only once
    for program in churns:
        program.batch()
    first = before = settled(deployment, None)
    grown: dict[str, list[float]] = {name: [] for name in before.used}
    for _ in range(ROUNDS):
        for program in churns:
            for _ in range(BATCHES):
                program.batch()
        after = settled(deployment, first)
        for name, used in before.used.items():
            growth = (after.used[name].rss - used.rss) * 1e6 / (len(SIDES) * BATCHES * churn.BATCH)
            grown[name].append(round(growth))
            assert after.used[name].threads <= first.used[name].threads + SPARE_THREADS, name
            assert after.used[name].descriptors <= first.used[name].descriptors + SPARE_THREADS, name
        if all(min(rounds) < MOST_EACH for rounds in grown.values()):
            return
        before = after
    raise AssertionError(f"bytes per endpoint, by round: {grown}")


def settled(deployment: Deployment, before: Census | None) -> Census:
    """Return the daemon's census once only the feeds remain; idle threads end ten seconds later."""
    feeds = len(SIDES) * (churn.FED + churn.STREAMED)
    last: list[tuple[int, int]] = []

    def left() -> Census | None:
        routes = sum(deployment.routes("/churn").values()) + sum(deployment.routes("/kept").values())
        census = deployment.census()
        last.append((census.tokens, census.registrations))
        stable = last[-2:] == [last[-1]] * 2  # tokens and registrations are removed shortly after the routes
        idle = (
            stable
            if before is None
            else (
                last[-1] == (before.tokens, before.registrations)
                and all(census.used[w].threads <= before.used[w].threads + SPARE_THREADS for w in WORKERS)
            )
        )
        return census if not routes and idle and sum(census.routes.values()) >= feeds else None

    try:
        return until(left, "the endpoints are removed", 40, every=0.5)
    except AssertionError:
        print(before, deployment.census(), deployment.routes("/churn"), deployment.routes("/kept"), sep="\n")
        raise


@pytest.mark.parametrize("side", SIDES)
def test_a_slow_subscriber_uses_bounded_memory_and_does_not_delay_others(deployment: Deployment, side: str) -> None:
    """The subscriber reads one message per second of a 40 MB/s stream.

    The sides are tested one at a time, because two cores can carry only one such stream.
    """
    (slow,) = slow_consumer.measure(deployment, [side], rate=40.0, seconds=SLOW_SECONDS, alone=1.0)
    small, big = slow.beside[slow_consumer.SMALL], slow.beside[slow_consumer.BIG]
    assert slow.read < 15, "the slow subscriber is slow"
    assert small.sent > 100
    assert (small.repeated, big.repeated) == (0, 0)
    if side == "zenoh":  # links drop messages for a slow reader, and large messages wait for it (docs/sides/hub.md)
        assert small.lost <= small.sent // 50
    else:
        assert small.lost == 0
        assert big.lost < big.sent / 10
    for name, most in slow.memory_beside.items():
        assert most - slow.memory_before[name] < 100, f"{name}: memory grew to {most} MB"
    if side == "ros1":
        assert slow.drops["slow"] > 0
