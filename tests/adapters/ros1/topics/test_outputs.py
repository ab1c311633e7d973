"""Small messages are written to subscribers' sockets in C; what a socket does not accept is sent by Python."""

from __future__ import annotations

import gc
import random
import threading
from collections.abc import Callable, Iterator

import pytest

from bridge.adapters.ros1.topics.outputs import Outputs, Socket
from tests.peers.native import RecordingOutput, exit_to, pass_on
from tests.peers.ros1.slow import Listener, Talker, c_socket, cut, frame, full_socket, until_free
from tests.support.no_threads import no_threads
from tests.support.wait import until


@pytest.fixture
def talker() -> Iterator[Talker]:
    talker = Talker()
    yield talker
    talker.close()


def large(number: int) -> bytes:
    """Return a message that a slow subscriber's socket soon does not accept."""
    return number.to_bytes(4, "little") + random.Random(number).randbytes(7000 + number % 5)


def test_all_subscribers_receive_whole_messages(talker: Talker) -> None:
    listeners = [talker.listen()[0] for _ in range(3)]
    messages = [b"", b"x", bytes(255), bytes(range(256)), bytes(4096), b"y" * 65536]
    for message in messages:
        assert talker.send(message)
    data = b"".join(map(frame, messages))
    assert [listener.read(len(data)) for listener in listeners] == [data] * 3


def test_a_fast_subscriber_needs_no_thread(talker: Talker) -> None:
    listener, connection = talker.listen()
    for number in range(100):
        assert talker.send(b"%d" % number)
        assert listener.message() == b"%d" % number
    assert c_socket(connection).messages == 100
    assert talker.threads() == []


def test_python_sends_the_rest_of_a_message_that_was_cut(talker: Talker) -> None:
    slow, connection = talker.listen(slow=True)
    sent = cut(talker, connection, large)
    assert connection.busy
    assert [slow.message() for _ in sent] == sent
    until_free(connection)
    assert not connection.busy


def test_messages_after_one_that_was_cut_are_left_to_python_and_keep_their_order(talker: Talker) -> None:
    slow, connection = talker.listen(slow=True)
    sent = cut(talker, connection, large)
    for number in range(20):
        assert not talker.send(b"no")
        sent.append(b"%d" % number)
        talker.send_by_python(sent[-1])
    assert [slow.message() for _ in sent] == sent
    until_free(connection)
    assert talker.send(b"again in C")
    assert slow.message() == b"again in C"


def test_one_subscriber_whose_message_is_cut_does_not_disturb_the_others(talker: Talker) -> None:
    before, slow, behind = talker.listen()[0], talker.listen(slow=True), talker.listen()[0]
    sent = cut(talker, slow[1], large)
    data = b"".join(map(frame, sent))
    assert (before.read(len(data)), behind.read(len(data))) == (data, data)
    assert slow[0].read(len(data)) == data
    assert before.is_silent()


def test_a_message_that_python_has_sent_in_part_keeps_c_from_sending(talker: Talker) -> None:
    slow, connection = talker.listen(slow=True)
    whole = bytes(200_000)
    talker.send_by_python(whole)
    assert not talker.send(b"second")
    talker.send_by_python(b"second")
    assert (slow.message(), slow.message()) == (whole, b"second")
    until_free(connection)


def test_a_connections_lock_keeps_c_from_sending(talker: Talker) -> None:
    (listener, _), (other, connection) = talker.listen(), talker.listen()
    with connection._lock:
        assert not talker.send(b"x")
    with talker.publication._lock:
        assert not talker.send(b"x")
    assert listener.is_silent()
    assert other.is_silent()
    assert talker.send(b"x")


class Garbage:
    """A cycle whose finalizer sends another message in C."""

    def __init__(self, finalize: Callable[[], object]) -> None:
        self.finalize, self.me = finalize, self

    def __del__(self) -> None:
        self.finalize()


def test_finalizers_do_not_change_a_message_that_is_being_sent() -> None:
    """The collector must not run before all sockets have the message."""
    other, fast = exit_to(RecordingOutput()), Listener()
    lists: list[list[int]] = []

    def prepare() -> bool:
        """Let the next object start a collection; it must not be one of the 80 lists that Python reuses."""
        gc.disable()
        lists.extend([] for _ in range(200))
        Garbage(lambda: pass_on(other, b"another message"))
        gc.enable()
        return False

    with full_socket() as full:
        sockets = Socket(full.fileno(), (), print), Socket(fast.theirs.fileno(), (prepare,), print)
        outputs = Outputs(())
        outputs.set(sockets)
        way, thresholds = exit_to(outputs), gc.get_threshold()
        gc.set_threshold(1)
        try:
            assert pass_on(way, b"message")
        finally:
            gc.set_threshold(*thresholds)
    assert sockets[0].take() + fast.read(11) == 2 * frame(b"message")
    fast.close()


@pytest.mark.parametrize("seed", range(6))
def test_random_mixes_of_c_and_python_corrupt_no_frame(talker: Talker, seed: int) -> None:
    """Each subscriber reads at random times, so that messages are cut at random bytes."""
    draw = random.Random(seed)
    readers = [talker.listen(slow=True) for _ in range(draw.randrange(1, 4))]
    received = [bytearray() for _ in readers]
    sent, by_c = bytearray(), 0
    for number in range(1500):
        payload = number.to_bytes(4, "little") + draw.randbytes(draw.choice((0, 10, 500, 3000)))
        if draw.random() < 0.15:
            talker.send_by_python(payload)
        else:
            by_c += talker.send_as_a_route(payload)
        sent += frame(payload)
        for (listener, connection), data in zip(readers, received, strict=True):
            if draw.random() < 0.1 or connection.waiting > 30:
                data += listener.read(draw.randrange(len(sent) - len(data) + 1))
        if draw.random() < 0.05:
            for (listener, connection), data in zip(readers, received, strict=True):
                data += listener.read(len(sent) - len(data))
                until_free(connection)
    for (listener, _), data in zip(readers, received, strict=True):
        data += listener.read(len(sent) - len(data))
    assert [data == sent for data in received] == [True] * len(readers)
    assert by_c > 50, "C has sent"
    for _, connection in readers:
        until_free(connection)
        assert connection.dropped == 0
        assert connection.counts() == (len(sent), 1500)


def test_a_thread_of_python_and_c_do_not_mix_their_frames(talker: Talker) -> None:
    slow, connection = talker.listen(slow=True)
    counts = {b"p": 0, b"c": 0}

    def talk() -> None:
        for number in range(1000):
            talker.send_by_python(b"p%d " % number + bytes(number % 3000))

    def listen() -> None:
        for _ in range(2000):
            message = slow.message()
            number, _, rest = message[1:].partition(b" ")
            assert int(number) == counts[message[:1]]
            assert rest == bytes(int(number) % 3000)
            counts[message[:1]] += 1

    threads = [threading.Thread(target=run) for run in (talk, listen)]
    for thread in threads:
        thread.start()
    for number in range(1000):
        talker.send_as_a_route(b"c%d " % number + bytes(number % 3000))
    for thread in threads:
        thread.join(60)
    assert counts == {b"p": 1000, b"c": 1000}
    until_free(connection)


def test_the_rest_of_a_message_waits_until_a_thread_can_start(talker: Talker) -> None:
    slow, connection = talker.listen(slow=True)
    with no_threads("midspan-ros1-out"):
        sent = cut(talker, connection, large)
        assert not talker.send(b"next")
    sent.append(b"next")
    talker.send_by_python(sent[-1])
    assert [slow.message() for _ in sent] == sent


def test_a_socket_that_accepts_nothing_keeps_the_whole_frame() -> None:
    calls: list[str] = []
    with full_socket() as full:
        sock = Socket(full.fileno(), (), lambda: calls.append("resume"))
        outputs = Outputs(())
        outputs.set((sock,))
        assert pass_on(exit_to(outputs), b"whole")
    assert (calls, sock.free, sock.cut, sock.failed) == (["resume"], False, True, False)
    assert (sock.bytes, sock.messages, outputs.bytes) == (0, 0, 5)
    assert (sock.take(), sock.cut, sock.take()) == (frame(b"whole"), False, b"")


def test_a_broken_connection_fails_once(talker: Talker) -> None:
    listener, connection = talker.listen()
    other, _ = talker.listen()
    changes = talker.changes
    talker.loop.remove(connection)  # only sending detects the end
    listener.sock.close()
    number = 0

    def removed() -> bool:
        nonlocal number
        number += talker.send(b"x")
        return connection.done

    until(removed, "the connection has failed")
    assert c_socket(connection).failed
    assert (talker.changes - changes, len(talker.publication.connections)) == (1, 1)
    assert other.read(5 * number) == frame(b"x") * number
    assert talker.send(b"on")
    assert other.message() == b"on"


def test_an_error_of_one_connection_does_not_keep_others_from_resuming() -> None:
    resumed: list[int] = []
    listeners = [Listener(slow=True) for _ in range(2)]
    sockets = [
        Socket(listener.theirs.fileno(), (), lambda n=n: resumed.append(n)) for n, listener in enumerate(listeners)
    ]
    outputs = Outputs(())
    outputs.set(tuple(sockets))
    way = exit_to(outputs)
    for listener in listeners:
        listener.theirs.close()
    assert pass_on(way, b"x"), "a descriptor that is closed"
    assert (resumed, [sock.failed for sock in sockets]) == ([0, 1], [True, True])
    assert not pass_on(way, b"x")
    for listener in listeners:
        listener.sock.close()
