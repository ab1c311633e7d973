"""Helpers for tests of the lane."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import pairwise

from bridge.hub.endpoints.lane_subscription import LaneSubscription
from tests.peers.hub.endpoints import Subscriber
from tests.support.wait import until


def subscription(heard: Subscriber) -> LaneSubscription:
    """Return a subscriber's subscription, which can use the lane."""
    assert isinstance(heard.subscription, LaneSubscription)
    return heard.subscription


def goes_by(heard: Subscriber, way: str, why: str = "") -> None:
    """Wait until all messages use the transport ``way``, for a reason that contains ``why``."""
    chosen = subscription(heard)

    def so() -> bool:
        return chosen.way == way and chosen.settled and why in chosen.why

    try:
        until(so, f"{chosen.topic} uses {way} {why}")
    except AssertionError as err:
        err.add_note(f"it uses {chosen.way} ({chosen.why}), settled: {chosen.settled}")
        raise


def whole(texts: list[str]) -> None:
    """Check that the numbers are complete and in order, without duplicates."""
    numbers = [int(text) for text in texts]
    missing = sorted(set(range(numbers[0], numbers[-1] + 1)) - set(numbers))
    twice = sorted(number for number, count in Counter(numbers).items() if count > 1)
    back = [after for before, after in pairwise(numbers) if after < before]
    assert (missing, twice, back) == ([], [], []), f"of {len(numbers)} missing {missing}, twice {twice}, behind {back}"


class Link:
    """A reader's connection that only reports when its joined messages are sent."""

    def __init__(self, send_joined: Callable[[], object]) -> None:
        self.send_joined = send_joined
