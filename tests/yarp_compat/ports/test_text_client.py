"""An exchange of lines, and its deadline."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterator

import pytest

from yarp_compat.ports.text_client import LineSocket


class Peer:
    """The other end of an exchange."""

    def __init__(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            self.lines = LineSocket("127.0.0.1", listener.getsockname()[1], 60.0).open()
            self.end = listener.accept()[0]

    def send(self, data: bytes) -> None:
        """Send bytes, and wait until they have arrived."""
        self.end.sendall(data)
        self.wait()

    def close(self) -> None:
        """Close this end, and wait until the other end has noticed that."""
        self.end.close()
        self.wait()

    def wait(self) -> None:
        assert self.lines._socket is not None
        select.select([self.lines._socket], [], [], 60)


@pytest.fixture
def peer() -> Iterator[Peer]:
    peer = Peer()
    with peer.lines, peer.end:
        yield peer


def test_an_answer_that_has_arrived_is_read_after_the_deadline(peer: Peer) -> None:
    """This process may have been starved for longer than the exchange may last."""
    peer.send(b"one\r\ntwo\r\n")
    peer.lines.hurry(0.0)
    assert [peer.lines.line(), peer.lines.line()] == ["one", "two"]
    with pytest.raises(TimeoutError):
        peer.lines.line()


def test_a_partial_answer_fails_at_the_deadline(peer: Peer) -> None:
    peer.send(b"on")
    peer.lines.hurry(0.2)
    with pytest.raises(TimeoutError):
        peer.lines.line()


def test_nothing_is_sent_after_the_deadline(peer: Peer) -> None:
    peer.lines.hurry(0.0)
    with pytest.raises(TimeoutError):
        peer.lines.send(b"late")
    peer.lines.close()
    assert peer.end.recv(10) == b""


def test_a_peer_that_closes_is_reported_after_the_deadline(peer: Peer) -> None:
    peer.close()
    peer.lines.hurry(0.0)
    with pytest.raises(OSError, match=r"closed before|reset") as raised:
        peer.lines.line()
    assert not isinstance(raised.value, TimeoutError)
