"""Connections that also send in C: their counters, their end, and the end of their publication."""

from __future__ import annotations

import gc
import itertools
import sys
import weakref
from collections.abc import Iterator

import pytest

from bridge.adapters.ros1.topics.commands import CommandConnection
from bridge.adapters.ros1.topics.outputs import Outputs, Socket
from tests.peers.native import RecordingOutput, exit_to, pass_on
from tests.peers.ros1.slow import TOPIC, Listener, Talker, c_socket, cut, frame, until_free
from tests.support.wait import until


@pytest.fixture
def talker() -> Iterator[Talker]:
    talker = Talker()
    yield talker
    talker.close()


def test_messages_of_c_and_python_are_counted_together(talker: Talker) -> None:
    listener, connection = talker.listen()
    talker.send(b"12345")
    talker.send_by_python(b"123")
    talker.send(b"")
    assert listener.read(20) == frame(b"12345") + frame(b"123") + frame(b"")
    assert connection.counts() == (20, 3), "with the lengths in front"
    assert talker.publication.bus_stats() == [TOPIC, 8, [[connection.id, 20, 3, True]]], (
        "payloads, then each connection"
    )


def test_a_message_that_was_cut_is_counted_once_it_is_sent(talker: Talker) -> None:
    slow, connection = talker.listen(slow=True)
    sent = cut(talker, connection, lambda _: bytes(5000))
    size, messages = connection.counts()
    assert size <= 5004 * len(sent)
    assert messages >= len(sent) - 1
    slow.read(5004 * len(sent))
    until_free(connection)
    assert connection.counts() == (5004 * len(sent), len(sent))
    assert talker.publication.bus_stats()[1] == 5000 * len(sent)


def test_messages_without_subscribers_are_counted_as_published(talker: Talker) -> None:
    assert talker.send(b"12345")
    assert talker.publication.bus_stats() == [TOPIC, 5, []]


def test_counters_beyond_32_bits_are_reported(talker: Talker) -> None:
    talker.publication.published = 2**31
    talker.send(b"1")
    assert talker.publication.bus_stats()[1] == 2.0**31 + 1


def test_a_subscriber_that_closes_is_removed_once(talker: Talker) -> None:
    (listener, connection), (other, _) = talker.listen(), talker.listen()
    changes = talker.changes
    listener.sock.close()
    until(lambda: talker.changes > changes, "it is removed")
    talker.publication.remove(connection)
    assert (talker.changes - changes, connection.done, c_socket(connection).free) == (1, True, False)
    assert talker.send(b"x")
    assert other.message() == b"x"


def test_a_slow_subscriber_that_closes_is_removed_once(talker: Talker) -> None:
    (slow, connection), (other, _) = talker.listen(slow=True), talker.listen()
    changes = talker.changes
    sent = cut(talker, connection, lambda _: bytes(5000))
    slow.sock.close()
    until(lambda: talker.changes > changes and not talker.threads(), "it is removed, and its thread has ended")
    assert (talker.changes - changes, connection.done, c_socket(connection).free) == (1, True, False)
    assert talker.send(b"on")
    assert [other.message() for _ in sent] == sent
    assert other.message() == b"on"


def test_a_message_that_fails_on_two_connections_removes_both(talker: Talker) -> None:
    pairs = [talker.listen() for _ in range(2)]
    third, _ = talker.listen()
    changes = talker.changes
    for listener, connection in pairs:
        talker.loop.remove(connection)
        listener.sock.close()
    until(lambda: talker.send(b"x") and talker.changes - changes == 2, "both are removed")
    assert len(talker.publication.connections) == 1
    assert third.message() == b"x"


def test_a_connection_that_is_closed_is_not_written_to(talker: Talker) -> None:
    """Its descriptor may belong to another connection."""
    _, connection = talker.listen()
    talker.loop.remove(connection)  # otherwise it removes the connection
    connection.close()
    assert not talker.send(b"x")
    talker.send_by_python(b"x")
    assert talker.publication.connections == ()
    assert talker.send(b"x")


def test_a_closed_publication_sends_nothing(talker: Talker) -> None:
    listener, connection = talker.listen()
    talker.send(b"last")
    talker.publication.close()
    assert not talker.send(b"x")
    talker.send_by_python(b"x")
    assert listener.message() == b"last"
    assert listener.sock.recv(1) == b""
    assert (talker.outputs.open, connection.counts()) == (False, (8, 1))


def test_a_subscriber_that_is_admitted_later_receives_the_next_message(talker: Talker) -> None:
    first, _ = talker.listen()
    talker.send(b"1")
    second, _ = talker.listen()
    talker.send(b"2")
    assert (first.message(), first.message(), second.message()) == (b"1", b"2", b"2")


def test_retained_messages_that_are_still_being_sent_stay_before_those_of_c(talker: Talker) -> None:
    talker.publication.send(bytes(200_000), "source", 1, retain=True)
    listener = Listener(slow=True)
    talker.admit(listener)
    assert not talker.send(b"x"), "the retained message does not fit"
    talker.send_by_python(b"x")
    listener.message()
    assert (listener.message(), listener.message()) == (bytes(200_000), b"x")


def test_commands_are_never_sent_in_c() -> None:
    listener = Listener()
    connection = CommandConnection(listener.theirs, "test-out", "/driver", print, "geometry_msgs/Twist", 1.0)
    assert connection.socket is None
    assert connection.counts() == (0, 0)
    connection.close()
    listener.sock.close()


def test_outputs_consist_of_sockets() -> None:
    outputs = Outputs(())
    for wrong in ((1,), (Outputs(()),), []):
        with pytest.raises((TypeError, SystemError)):
            outputs.set(wrong)
    assert pass_on(exit_to(outputs), b"x")
    with pytest.raises(TypeError):
        Socket(0, [], print)


def test_an_error_in_a_lock_counts_as_held() -> None:
    def fail() -> bool:
        raise ZeroDivisionError

    outputs = Outputs((fail,))
    assert not pass_on(exit_to(outputs), b"x"), "the error is cleared"


def test_the_newest_publication_of_an_exit_sends(talker: Talker) -> None:
    listener, _ = talker.listen()
    talker.exit.send_by(RecordingOutput())
    assert talker.send(b"no")
    talker.exit.send_by(talker.outputs)
    assert talker.send(b"yes")
    assert listener.message() == b"yes"


def test_nothing_leaks_over_many_messages(talker: Talker) -> None:
    slow, connection = talker.listen(slow=True)
    counts = []
    for _ in range(4):
        for _ in range(100):
            sent = cut(talker, connection, lambda _: bytes(1000))
            slow.read(1004 * len(sent))
            until_free(connection)
        for _ in range(2000):
            talker.send(b"x")
            slow.message()
        gc.collect()
        counts.append(sys.getallocatedblocks())
    # each part would leak as much; other threads of the process allocate now and then
    assert min(after - before for before, after in itertools.pairwise(counts)) < 500


def test_a_cycle_of_sockets_and_outputs_is_collected() -> None:
    class Resume:
        def __init__(self, outputs: Outputs) -> None:
            self.outputs = outputs

        def __call__(self) -> None: ...

    outputs = Outputs(())
    resume = Resume(outputs)
    outputs.set((Socket(0, (), resume),))
    resumed = weakref.ref(resume)
    del resume, outputs
    gc.collect()
    assert resumed() is None
