"""Calls of YARP clients that a module's thread comes to too late, and a robot's ports connected to ours."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import MagicMock

import pytest

from bridge.modules.loop import EventLoop
from navigation import yarp as calls_module
from navigation.gateway import services as gateway
from navigation.gateway.services import VelocityCommander
from navigation.gateway.stop import StopAnswer
from navigation.robot_goto import ports as robot_goto
from navigation.robot_path_planner import ports as planner
from navigation.yarp import Calls, PortConnection
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
def held() -> Iterator[tuple[EventLoop, threading.Event]]:
    """A thread that is in one step until the event is set."""
    loop, go_on, begun = EventLoop("the module"), threading.Event(), threading.Event()
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
    held: tuple[EventLoop, threading.Event], monkeypatch: pytest.MonkeyPatch
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


def test_what_moves_the_robot_and_has_begun_is_wait_for() -> None:
    loop, tired = EventLoop("the module"), threading.Event()
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


def test_a_velocity_that_waited_is_not_commanded(held: tuple[EventLoop, threading.Event]) -> None:
    loop, go_on = held
    out = MagicMock()
    host: Any = SimpleNamespace(
        loop=loop, log=MagicMock(), node=SimpleNamespace(publisher=lambda *_args, **_options: out)
    )
    commander = VelocityCommander(host, "/cmd_vel")
    device = gateway.GatewayDevice(host, MagicMock(has_base=False), MagicMock(), commander, MagicMock())
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
        *((gateway.GatewayDevice, move) for move in MOVES),
        *(
            (kind, move)
            for kind in (robot_goto.GotoDevice, planner.PathPlannerDevice)
            for move in MOVES
            if hasattr(kind, move)
        ),
        (robot_goto.GotoServer, "Approach"),
    ],
)
def test_of_every_device_what_moves_the_robot_is_bound_in_time_and_a_stop_is_not(
    kind: Any, move: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = MagicMock()
    monkeypatch.setattr(gateway, "Calls", lambda *_given: calls)
    given: tuple[Any, ...] = (MagicMock(), calls, MagicMock(), MagicMock())
    if kind is gateway.GatewayDevice:
        given = (MagicMock(),) * 5
    elif kind is robot_goto.GotoDevice:
        given = given[:2]
    device = kind(*given)
    getattr(device, move)(*MOVES.get(move, (0.0, 0.1, 1.0)))
    assert calls.move.called
    assert not calls.do.called
    if hasattr(device, "stopNavigation"):
        calls.move.reset_mock()
        calls.do.return_value = told = StopAnswer()
        told.put("")  # it has stopped
        device.stopNavigation()
        assert calls.do.called
        assert not calls.move.called


class Hanging:
    """A name server that does not answer for long."""

    def __init__(self) -> None:
        self.asked, self.goes_on = threading.Event(), threading.Event()

    def query(self, *_arguments: object, **_options: object) -> None:
        self.asked.set()
        self.goes_on.wait(40)


@pytest.fixture
def names() -> Iterator[Hanging]:
    hanging = Hanging()
    yield hanging
    hanging.goes_on.set()


def test_a_module_stops_in_time_also_while_its_ports_are_being_connected(names: Hanging):
    """`bridge.modules.worker` gives it one second; what hangs here does for longer than a loaded machine takes."""
    connected = PortConnection(cast("Any", names), "/laser:o", "/mine/laser:i")
    assert names.asked.wait(40)
    begun = time.monotonic()
    connected.close()
    assert time.monotonic() - begun < 20.0
    assert connected.trouble == "/laser:o is not connected yet"
