"""Publishing in several versions of a type: which version gets what, and the filters of the writers."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from bridge.adapters.ros2.filters import is_available
from bridge.adapters.ros2.participant import Participant
from bridge.adapters.ros2.topics.versioned import VersionedPublisher
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.errors import ConversionError, MessageTypeError
from tests.adapters.ros2.conftest import RunningEdge
from tests.support.wait import until

LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=2)
RANGE = "sensor_msgs/msg/Range"


class Recorder:
    """A publisher that records what it is sent; it stands in for `Ros2Publisher`."""

    topic, type_name, has_subscribers = "/wheels", "fleet_msgs/msg/Wheel", True

    def __init__(self, qos: Qos = LATCHED) -> None:
        self.qos = qos
        self.sent: list[tuple[bytes, str]] = []
        self.closed = False

    def send(self, payload: bytes | memoryview, source: str) -> None:
        self.sent.append((bytes(payload), source))

    def drop_source(self, source: str) -> None:
        self.sent = [sent for sent in self.sent if sent[1] != source]

    def refit(self) -> None: ...

    def close(self) -> None:
        self.closed = True


def upper(payload: bytes) -> bytes:
    """Convert to the version "new", which cannot hold ``bad``."""
    if payload == b"bad":
        raise ConversionError("it does not fit")
    return payload.upper()


class TwoVersionPublisher:
    """A publisher with the versions "new", which is converted, and "same", whose bytes are those of this machine."""

    def __init__(self, qos: Qos = LATCHED) -> None:
        self.wanted: set[str] = set()
        self.here = Recorder(qos)
        self.others: dict[str, Recorder] = {}
        here: Any = self.here
        converters = {"new": upper, "same": None}
        self.publisher = VersionedPublisher(here, converters, self._open, lambda: self.wanted, lambda _: None)

    def _open(self, version: str) -> Any:
        self.others[version] = Recorder(self.here.qos)
        return self.others[version]

    def follow(self, *versions: str) -> None:
        self.wanted = set(versions)
        self.publisher.refit()


def test_each_version_gets_its_messages_while_it_has_subscriptions() -> None:
    versions = TwoVersionPublisher(Qos())
    versions.follow("here", "unknown")
    versions.publisher.send(b"a", "s")
    assert not versions.others
    versions.follow("new", "same")
    versions.publisher.send(b"b", "s")
    assert [sent for sent, _ in versions.here.sent] == [b"a", b"b"]
    assert {version: end.sent for version, end in versions.others.items()} == {
        "new": [(b"B", "s")],
        "same": [(b"b", "s")],
    }
    versions.follow("same")
    assert versions.others["new"].closed
    assert not versions.others["same"].closed
    versions.publisher.close()
    assert versions.others["same"].closed
    versions.follow("new")
    assert versions.others["new"].closed, "a closed publisher opens none"


def test_a_new_version_gets_the_last_latched_messages_of_each_source(caplog: pytest.LogCaptureFixture) -> None:
    versions = TwoVersionPublisher()
    for payload, source in ((b"a", "s"), (b"b", "s"), (b"bad", "s"), (b"c", "t"), (b"d", "gone")):
        versions.publisher.send(payload, source)
    versions.publisher.drop_source("gone")
    versions.follow("new")
    assert versions.others["new"].sent == [(b"B", "s"), (b"C", "t")]
    assert "/wheels: a retained message was not published in another version: it does not fit" in caplog.text


def test_a_message_in_the_memory_of_another_worker_is_copied_if_it_is_retained_or_converted() -> None:
    versions, memory = TwoVersionPublisher(), bytearray(b"a")
    versions.follow("new", "same")
    versions.publisher.send(memoryview(memory), "s")
    memory[:] = b"x"
    versions.follow()
    versions.follow("same")
    assert [end.sent for end in (versions.here, *versions.others.values())] == [
        [(b"a", "s")],
        [(b"A", "s")],
        [(b"a", "s")],
    ]


def test_versions_that_another_thread_has_read_earlier_are_not_applied_last() -> None:
    versions = TwoVersionPublisher()
    reads, graph_is_read = threading.Event(), threading.Event()

    def read_before_the_new_subscription() -> set[str]:
        versions.publisher._wanted = lambda: {"new"}
        reads.set()
        graph_is_read.wait(20)
        return set()

    versions.publisher._wanted = read_before_the_new_subscription
    starved, other = (threading.Thread(target=versions.publisher.refit) for _ in range(2))
    starved.start()
    until(reads.is_set, "the first thread reads the graph")
    other.start()
    other.join(0.1)  # without the lock it ends here
    graph_is_read.set()
    for thread in (starved, other):
        thread.join(20)
    assert not versions.others["new"].closed


def test_a_message_that_one_version_cannot_hold_reaches_the_others() -> None:
    versions = TwoVersionPublisher()
    versions.follow("new", "same")
    with pytest.raises(ConversionError, match="does not fit"):
        versions.publisher.send(b"bad", "s")
    assert (versions.here.sent, versions.others["same"].sent, versions.others["new"].sent) == (
        [(b"bad", "s")],
        [(b"bad", "s")],
        [],
    )


@pytest.mark.parametrize("reliability", Reliability)
def test_only_reliable_writers_have_a_filter(edge: RunningEdge, reliability: Reliability) -> None:
    """Fast DDS has another class of writers for best effort; the edge publishes in one version then."""
    assert is_available()
    publisher = edge.edge.advertise("/ranges", edge.type(RANGE), Qos(reliability))
    assert isinstance(publisher, VersionedPublisher) is (reliability is Reliability.RELIABLE)


def test_a_writer_that_fast_dds_does_not_filter_is_refused(edge: RunningEdge, monkeypatch: pytest.MonkeyPatch) -> None:
    make_writer: Callable[..., Any] = Participant.make_writer
    best_effort = Qos(Reliability.BEST_EFFORT)
    monkeypatch.setattr(Participant, "make_writer", lambda self, *args: make_writer(self, *args[:2], best_effort))
    with pytest.raises(MessageTypeError, match="does not filter"):
        edge.edge.advertise("/ranges", edge.type(RANGE), Qos())


def test_without_the_extension_there_is_no_filter(monkeypatch: pytest.MonkeyPatch, edge: RunningEdge) -> None:
    monkeypatch.setattr("bridge.adapters.ros2.filters.is_available", lambda: False)
    publisher = edge.edge.advertise("/ranges", edge.type(RANGE), Qos())
    assert not isinstance(publisher, VersionedPublisher)
