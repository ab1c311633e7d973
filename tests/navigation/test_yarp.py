"""Calls of YARP clients that time out before the module's thread runs them, and connections to a robot's ports."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import MagicMock, call

import pytest

from bridge.clock import SYSTEM
from bridge.config.model import Config
from bridge.modules.loop import EventLoop
from navigation import yarp as calls_module
from navigation.gateway import services as gateway
from navigation.gateway.stop import StopAnswer
from navigation.gateway.velocities import VelocityCommander, YarpVelocity
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
    """A module's event loop whose thread is busy until the event is set."""
    loop, resume, begun = EventLoop("the module"), threading.Event(), threading.Event()
    loop.start()
    loop.post(lambda: (begun.set(), resume.wait(40)))
    assert begun.wait(40)
    yield loop, resume
    resume.set()
    loop.close()


def refused(ask: Callable[[], Any]) -> str:
    with pytest.raises(CallFailed) as error:
        ask()
    assert error.value.code is ReturnCode.NOT_READY
    return str(error.value)


def test_a_move_is_dropped_once_its_client_has_timed_out(
    held: tuple[EventLoop, threading.Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, resume = held
    done: list[str] = []
    monkeypatch.setattr(calls_module, "ANSWER_SECONDS", 0.05)
    assert "has not answered" in refused(lambda: Calls(loop).move(lambda: done.append("move"), 0.05))
    assert "has not answered" in refused(lambda: Calls(loop).do(lambda: done.append("stop")))
    resume.set()
    loop.call(lambda: None)
    assert done == ["stop"]
    loop.close()
    assert "has ended" in refused(lambda: Calls(loop).do(lambda: done.append("too late")))


def test_a_move_that_has_started_is_waited_for() -> None:
    loop, begun, timed_out = EventLoop("the module"), threading.Event(), threading.Event()
    loop.start()
    withdrawn = loop._withdrawn

    def seen(call: Any) -> bool:
        client = threading.current_thread() is not loop._thread
        if client:
            assert begun.wait(40)  # the module's thread may be starved for longer than the client waits
        result = withdrawn(call)
        if client:
            timed_out.set()
        return result

    def move() -> bool:
        begun.set()
        return timed_out.wait(40)

    loop._withdrawn = seen  # type: ignore[method-assign]
    assert Calls(loop).move(move, seconds=0.05)
    loop.close()


def test_a_velocity_whose_client_timed_out_is_not_published(
    held: tuple[EventLoop, threading.Event], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    loop, resume = held
    out = MagicMock()
    graph = SimpleNamespace(subscriptions=lambda _topic: [], velocities=list, drivers=lambda _topic: {})
    hub = SimpleNamespace(graph=graph, zid="1", announce_driver=MagicMock())
    node = SimpleNamespace(publisher=lambda *_args, **_options: out, hub=hub)
    host: Any = SimpleNamespace(
        name="gateway", loop=loop, log=MagicMock(), node=node, config=Config(), clock=SYSTEM, folder=tmp_path,
        background=MagicMock(),
    )  # fmt: skip
    commander = VelocityCommander(host, "/cmd_vel", lambda: False)
    device = gateway.GatewayDevice(host, MagicMock(has_base=False), MagicMock(), commander, MagicMock())
    refused(lambda: device.applyVelocityCommand(0.3, 0.0, 0.0, 1.0))
    resume.set()
    loop.call(lambda: None)
    out.publish.assert_not_called()
    assert commander.last is None
    monkeypatch.setattr(gateway, "_FRESH_SECONDS", 20.0)
    device.applyVelocityCommand(0.3, 0.0, 0.0, 1.0)
    assert out.publish.call_args_list[0].args[0]["linear"]["x"] == 0.3  # zero follows after a second


def test_a_velocity_that_is_dropped_is_no_pause_of_its_client(held: tuple[EventLoop, threading.Event]) -> None:
    loop, resume = held
    host, commander = MagicMock(loop=loop), MagicMock()
    device = gateway.GatewayDevice(host, MagicMock(has_base=False), MagicMock(), commander, MagicMock())
    refused(lambda: device.applyVelocityCommand(0.3, 0.0, 0.0, 1.0))
    resume.set()
    loop.call(lambda: None)
    assert commander.mock_calls == [call.note(YarpVelocity(0.3), 1.0)]


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
def test_moves_of_every_device_expire_with_their_client_but_stops_do_not(
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
        calls.do.return_value = answer = StopAnswer()
        answer.put("")  # the robot has stopped
        device.stopNavigation()
        assert calls.do.called
        assert not calls.move.called


class Hanging:
    """A name server that takes long to reply."""

    def __init__(self) -> None:
        self.queried, self.resume = threading.Event(), threading.Event()

    def query(self, *_arguments: object, **_options: object) -> None:
        self.queried.set()
        self.resume.wait(40)


@pytest.fixture
def names() -> Iterator[Hanging]:
    hanging = Hanging()
    yield hanging
    hanging.resume.set()


def test_a_module_stops_in_time_while_its_ports_connect(names: Hanging):
    """`bridge.modules.worker` gives the module one second; the name server hangs longer than a busy machine needs."""
    connected = PortConnection(cast("Any", names), "/laser:o", "/mine/laser:i")
    assert names.queried.wait(40)
    begun = time.monotonic()
    connected.close()
    assert time.monotonic() - begun < 20.0
    assert connected.trouble == "connecting to /laser:o"
