"""Programs read the dialects with zenoh's advanced subscribers, which use the source numbers of samples."""

from __future__ import annotations

from typing import Any

import pytest
import zenoh
from zenoh import ext

from bridge.adapters.zenoh.ros2dds_topics import is_later
from bridge.hub.zenoh_compat import SOURCE_NUMBERS
from tests.adapters.zenoh.conftest import Place
from tests.peers.zenoh.programs import open_session
from tests.support.wait import until

STRING = "std_msgs/String"
LAST = SOURCE_NUMBERS - 1


class Reader:
    """An advanced subscriber without options, on a separate session."""

    def __init__(self, endpoint: str, key: str) -> None:
        self.samples: list[zenoh.Sample] = []
        self._session = open_session(endpoint)
        handler = zenoh.handlers.Callback(self.samples.append, indirect=False)
        self._end = ext.declare_advanced_subscriber(self._session, key, handler)

    def is_linked(self) -> bool:
        """Return whether the session is linked to Midspan's directly; a burst may lose a message meanwhile."""
        return bool(self._session.info.peers_zid())

    def close(self) -> None:
        """Leave the network."""
        self._end.undeclare()
        self._session.close()


@pytest.mark.parametrize(
    ("dialect", "key"),
    [
        ({"dialect": "ros2dds"}, "orders"),
        ({"dialect": "ros1"}, "*/*/*/orders"),
        ({"dialect": "json", "keys": [{"key": "orders", "type": "std_msgs/msg/String", "direction": "out"}]}, "*"),
    ],
    ids=["ros2dds", "ros1", "json"],
)
def test_every_message_of_a_dialect_arrives(place: Place, dialect: dict[str, Any], key: str) -> None:
    reader = Reader(place.router.endpoint, key)
    place.bridge(dialect)
    until(reader.is_linked, "the reader is linked to Midspan")
    out = place.far.advertise("/orders", STRING)
    place.far.hub_publish_until(out, {"data": "probe"}, lambda: reader.samples)
    for number in range(20):
        place.far.publish(out, {"data": f"number {number}"})

    def numbers() -> list[int]:
        texts = [bytes(sample.payload) for sample in reader.samples]
        return [
            number for text in texts for number in range(20) if text.rstrip(b'\0"}').endswith(b"number %d" % number)
        ]

    until(lambda: 19 in numbers(), "the last message arrives")
    assert numbers() == list(range(20))
    reader.close()


def test_every_beacon_of_the_ros1_dialect_arrives(place: Place) -> None:
    """A program would ignore beacons without new source numbers, and then drop the topic."""
    reader = Reader(place.router.endpoint, "ros1_discovery_info/**")
    place.bridge({"dialect": "ros1"})
    place.far.advertise("/orders", STRING)

    def beacons() -> int:
        return sum(str(sample.key_expr).endswith("/orders") for sample in reader.samples)

    until(lambda: beacons() >= 4, "four beacons arrive")
    reader.close()


@pytest.mark.parametrize(
    ("sample", "last", "later"),
    [
        ((1, 0), (0, 0), True),
        ((1, 0), (1, 0), False),
        ((0, 0), (1, 0), False),
        ((0, 0), (LAST, 0), True),
        ((LAST, 0), (0, 0), False),
        ((1, 700), (1, 0), False),
        ((0, 700), (9, 500), True),
        ((0, 500), (9, 500), False),
        ((None, 700), (None, 500), True),
        ((None, 500), (None, 500), False),
        ((None, 0), (None, 500), True),
    ],
)
def test_a_sample_that_arrives_live_and_from_the_cache_counts_once(
    sample: tuple[int | None, int], last: tuple[int | None, int], later: bool
) -> None:
    """The sample is recognized by its number, which wraps around, or by its time after a restart with the same ID."""
    assert is_later(*sample, *last) == later
