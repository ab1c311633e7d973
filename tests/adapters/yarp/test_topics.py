"""An input port holds messages until their sender is known, and delivers them in order."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.yarp import topics
from bridge.adapters.yarp.topics import InputPort
from bridge.routing.edge import MadeBy
from bridge.routing.rules import COMMAND_SECONDS


class Maker:
    """A stand-in for the lookup of who created a peer."""

    def __init__(self, made_by: MadeBy) -> None:
        self.made_by = made_by

    def __call__(self, _: str) -> MadeBy:
        return self.made_by


class HeldMessages(dict[str, Any]):
    """The held messages, with a callback for the first lookup."""

    def __init__(self, then: Callable[[], None]) -> None:
        super().__init__()
        self._then: list[Callable[[], None]] = [then]

    def __contains__(self, key: object) -> bool:
        if self._then:
            self._then.pop()()
        return super().__contains__(key)


def make_port(made_by: Callable[[str], MadeBy]) -> InputPort:
    """Return an input port that delivers payloads unchanged."""
    codec: Any = SimpleNamespace(to_hub=lambda payload, _profile, _stamp: payload)
    return InputPort("/in", "/t", "T", codec, None, None, made_by, lambda *_: None)


def message(payload: bytes) -> Any:
    """Return a message from a peer."""
    peer = SimpleNamespace(route=SimpleNamespace(source="/w"), profile=None)
    return SimpleNamespace(peer=peer, payload=payload, envelope="")


def test_message_that_arrives_during_a_delivery_is_delivered_after_it() -> None:
    """An older command must not be delivered last."""
    maker, delivered = Maker(MadeBy.UNKNOWN), list[bytes]()
    input_port = make_port(maker)
    second = threading.Thread(target=lambda: input_port.on_message(message(b"2")))

    def deliver(cdr: bytes, *_: object) -> None:
        if cdr == b"1":
            second.start()
            second.join(0.3)  # the second delivery is waiting
        delivered.append(cdr)

    input_port.deliver_to(deliver)
    input_port.on_message(message(b"1"))
    maker.made_by = MadeBy.NATIVE
    input_port.release()
    second.join(20)
    assert delivered == [b"1", b"2"]
    assert input_port.waiting() == set()


def test_held_message_is_delivered_before_a_new_one() -> None:
    maker, delivered = Maker(MadeBy.UNKNOWN), list[bytes]()
    input_port = make_port(maker)
    input_port.deliver_to(lambda cdr, *_: delivered.append(cdr))
    input_port.on_message(message(b"1"))
    assert delivered == []
    maker.made_by = MadeBy.NATIVE
    input_port.on_message(message(b"2"))
    assert delivered == [b"1", b"2"]


def test_route_connected_during_a_message_receives_it() -> None:
    """The message is delivered at once, not with the next update, although no route existed when it arrived."""
    input_port, delivered = make_port(Maker(MadeBy.NATIVE)), list[bytes]()

    def connect_route() -> None:
        input_port.deliver_to(lambda cdr, *_: delivered.append(cdr))
        input_port.release()

    input_port._held = HeldMessages(connect_route)
    input_port.on_message(message(b"x"))
    assert delivered == [b"x"]


class Clock:
    """The clock of the held messages."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr(topics, "steady", lambda: self.now)


@pytest.mark.parametrize(("command", "expected"), [(True, []), (False, [b"1"])])
def test_old_command_is_not_delivered(monkeypatch: pytest.MonkeyPatch, *, command: bool, expected: list[bytes]) -> None:
    """A velocity whose sender was unknown for too long must not move the robot later; other messages are delivered."""
    clock = Clock(monkeypatch)
    input_port, delivered = make_port(Maker(MadeBy.NATIVE)), list[bytes]()
    input_port.on_message(message(b"1"))  # no route exists yet
    clock.now += COMMAND_SECONDS + 0.1
    input_port.deliver_to(lambda cdr, *_: delivered.append(cdr), command=command)
    input_port.release()
    assert delivered == expected
    input_port.on_message(message(b"2"))
    assert delivered == [*expected, b"2"]


def test_message_is_held_until_a_slow_update_of_the_graph_finds_its_sender(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, maker, delivered = Clock(monkeypatch), Maker(MadeBy.UNKNOWN), list[bytes]()
    input_port = make_port(maker)
    input_port.deliver_to(lambda cdr, *_: delivered.append(cdr))
    input_port.on_message(message(b"1"))
    for _ in range(2):
        clock.now += topics.HOLD_SECONDS + 1.0  # the name server is slow, or this process was stopped
        assert input_port.waiting() == {"/w"}
        input_port.mark_listed()
    maker.made_by = MadeBy.NATIVE
    input_port.release()
    assert delivered == [b"1"]


def test_message_without_a_route_is_dropped_after_its_sender_was_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, delivered = Clock(monkeypatch), list[bytes]()
    input_port = make_port(Maker(MadeBy.NATIVE))
    input_port.on_message(message(b"1"))
    clock.now += topics.HOLD_SECONDS + 1.0
    input_port.mark_listed()
    assert input_port.waiting() == {"/w"}, "the route may follow"
    clock.now += topics.HOLD_SECONDS + 0.1
    assert input_port.waiting() == set()
    input_port.deliver_to(lambda cdr, *_: delivered.append(cdr))
    input_port.release()
    assert delivered == []
