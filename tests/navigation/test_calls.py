"""What YARP's clients ask of the modules that drive, when a module's thread comes to it too late."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from bridge.modules.loop import Loop
from navigation import calls as calls_module
from navigation.calls import Calls
from navigation.gateway import device as gateway
from navigation.gateway.velocity import Commander
from navigation.robot_goto import device as robot_goto
from navigation.robot_path_planner import device as planner
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode

PLACE = Map2DLocation("", 1.0, 2.0, 0.0)
MOVES: dict[str, tuple[Any, ...]] = {
    "gotoTargetByAbsoluteLocation": (PLACE,),
    "gotoTargetByRelativeLocation": (1.0, 2.0, math.nan),
    "followPath": (Map2DPath([PLACE]),),
    "resumeNavigation": (),
    "applyVelocityCommand": (0.3, 0.0, 0.0, 1.0),
}


@pytest.fixture
def held() -> Iterator[tuple[Loop, threading.Event]]:
    """A thread that is in one step until the event is set."""
    loop, go_on, begun = Loop("the module"), threading.Event(), threading.Event()
    loop.start()
    loop.post(lambda: (begun.set(), go_on.wait(40)))
    assert begun.wait(40)
    yield loop, go_on
    go_on.set()
    loop.close()


def refused(ask: Callable[[], Any]) -> str:
    with pytest.raises(CallFailed) as error:
        ask()
    assert error.value.code is ReturnCode.NOT_READY
    return str(error.value)


def test_what_moves_the_robot_is_not_done_once_its_client_was_told_that_it_failed(
    held: tuple[Loop, threading.Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, go_on = held
    done: list[str] = []
    monkeypatch.setattr(calls_module, "ANSWER_SECONDS", 0.05)
    assert "has not answered" in refused(lambda: Calls(loop).move(lambda: done.append("move"), 0.05))
    assert "has not answered" in refused(lambda: Calls(loop).do(lambda: done.append("stop")))
    go_on.set()
    loop.call(lambda: None)
    assert done == ["stop"]
    loop.close()
    assert "has ended" in refused(lambda: Calls(loop).do(lambda: done.append("too late")))


def test_what_moves_the_robot_and_has_begun_is_waited_for() -> None:
    loop, tired = Loop("the module"), threading.Event()
    loop.start()
    withdrawn = loop._withdrawn

    def seen(call: Any) -> bool:
        found = withdrawn(call)
        if threading.current_thread() is not loop._thread:
            tired.set()
        return found

    loop._withdrawn = seen  # type: ignore[method-assign]
    assert Calls(loop).move(lambda: tired.wait(40), seconds=0.05)
    loop.close()


def test_a_velocity_that_waited_is_not_commanded(held: tuple[Loop, threading.Event]) -> None:
    loop, go_on = held
    out = MagicMock()
    host: Any = SimpleNamespace(loop=loop, node=SimpleNamespace(publisher=lambda *_args, **_options: out))
    commander = Commander(host, "/cmd_vel")
    device = gateway.Device(host, MagicMock(has_base=False), MagicMock(), commander)
    refused(lambda: device.applyVelocityCommand(0.3, 0.0, 0.0, 1.0))
    go_on.set()
    loop.call(lambda: None)
    out.publish.assert_not_called()
    assert commander.last is None
    device.applyVelocityCommand(0.3, 0.0, 0.0, 1.0)
    assert out.publish.call_args.args[0]["linear"]["x"] == 0.3


@pytest.mark.parametrize(
    ("kind", "move"),
    [
        *((gateway.Device, move) for move in MOVES),
        *((kind, move) for kind in (robot_goto.Device, planner.Device) for move in MOVES if hasattr(kind, move)),
        (robot_goto.GotoServer, "Approach"),
    ],
)
def test_of_every_device_what_moves_the_robot_is_bound_in_time_and_a_stop_is_not(
    kind: Any, move: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = MagicMock()
    monkeypatch.setattr(gateway, "Calls", lambda *_given: calls)
    given = (MagicMock(),) * 4 if kind is gateway.Device else (MagicMock(), calls)
    device = kind(*given)
    getattr(device, move)(*MOVES.get(move, (0.0, 0.1, 1.0)))
    assert calls.move.called
    assert not calls.do.called
    if hasattr(device, "stopNavigation"):
        calls.move.reset_mock()
        calls.do.return_value = False  # it has stopped
        device.stopNavigation()
        assert calls.do.called
        assert not calls.move.called
