"""An input port of ours: what waits until it is known who sent it, and its order."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from bridge.adapters.yarp.topics import InputPort
from bridge.routing.edge import MadeBy


class Maker:
    """Who made the peer."""

    def __init__(self, made_by: MadeBy) -> None:
        self.made_by = made_by

    def __call__(self, _: str) -> MadeBy:
        return self.made_by


class Asked(dict[str, Any]):
    """What is held, with something that happens as it is first looked for."""

    def __init__(self, then: Callable[[], None]) -> None:
        super().__init__()
        self._then: list[Callable[[], None]] = [then]

    def __contains__(self, key: object) -> bool:
        if self._then:
            self._then.pop()()
        return super().__contains__(key)


def made(made_by: Callable[[str], MadeBy]) -> InputPort:
    """One whose messages are what came."""
    codec: Any = SimpleNamespace(to_hub=lambda payload, _profile, _stamp: payload)
    return InputPort("/in", "/t", "T", codec, None, None, made_by, lambda *_: None)


def message(payload: bytes) -> Any:
    """What one peer says."""
    peer = SimpleNamespace(route=SimpleNamespace(source="/w"), profile=None)
    return SimpleNamespace(peer=peer, payload=payload, envelope="")


def test_what_comes_while_the_one_before_is_passed_on_comes_behind_it() -> None:
    """An old command is never the last one."""
    maker, got = Maker(MadeBy.UNKNOWN), list[bytes]()
    input_port = made(maker)
    second = threading.Thread(target=lambda: input_port.on_message(message(b"2")))

    def deliver(cdr: bytes, *_: object) -> None:
        if cdr == b"1":
            second.start()
            second.join(0.3)  # it waits
        got.append(cdr)

    input_port.deliver_to(deliver)
    input_port.on_message(message(b"1"))
    maker.made_by = MadeBy.NATIVE
    input_port.release()
    second.join(20)
    assert got == [b"1", b"2"]
    assert input_port.waiting() == set()


def test_what_waits_is_passed_on_before_what_comes() -> None:
    maker, got = Maker(MadeBy.UNKNOWN), list[bytes]()
    input_port = made(maker)
    input_port.deliver_to(lambda cdr, *_: got.append(cdr))
    input_port.on_message(message(b"1"))
    assert got == []
    maker.made_by = MadeBy.NATIVE
    input_port.on_message(message(b"2"))
    assert got == [b"1", b"2"]


def test_a_route_that_comes_with_a_message_hears_it() -> None:
    """Who looked for a route before it came has the message passed on at once, not when the clerk looks again."""
    input_port, got = made(Maker(MadeBy.NATIVE)), list[bytes]()

    def hear() -> None:
        input_port.deliver_to(lambda cdr, *_: got.append(cdr))
        input_port.release()

    input_port._held = Asked(hear)
    input_port.on_message(message(b"x"))
    assert got == [b"x"]
