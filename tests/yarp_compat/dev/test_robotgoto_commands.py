"""robotGoto's commands, as text and as a service, together with INavigation2D on one port."""

from __future__ import annotations

from typing import Any

import pytest

from tests.yarp_compat.dev.test_service import FAIL, Wire
from yarp_compat.dev.inavigation2d import INavigation2DMsgs, Navigation2DServer, NavigationStatusEnum
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.robotgoto_commands import RobotGotoMsgs
from yarp_compat.dev.server import Server
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab


class Goto(RobotGotoMsgs, Navigation2DServer):
    """A device with both interfaces, which records its calls."""

    def __init__(self) -> None:
        super().__init__(self)
        self.recorded: list[tuple[Any, ...]] = []

    def __getattribute__(self, name: str) -> Any:
        if name.startswith("Set") and name != "SetMaxAngularSpeed":
            return lambda value: self.record(name, value)
        return super().__getattribute__(name)

    def record(self, *call: Any) -> ReturnValue:
        self.recorded.append(call)
        return OK

    def ResetParams(self) -> ReturnValue:
        return self.record("ResetParams")

    def Approach(self, dir: float, speed: float, time: float) -> ReturnValue:  # noqa: A002
        if speed > 1:
            raise CallFailed(ReturnCode.OUT_OF_BOUNDS, "that is too fast")
        return self.record("Approach", dir, speed, time)

    def GetNavigationStatus(self) -> tuple[ReturnValue, str]:
        return OK, "navigation_status_idle"

    def getNavigationStatus(self) -> str:
        return "idle"


@pytest.fixture
def goto() -> Goto:
    return Goto()


@pytest.mark.parametrize("profile", Profile)
def test_text_commands_are_executed(goto: Goto, profile: Profile) -> None:
    server = Server(goto, Generations(Generation.newest(profile)))

    def ask(*words: Any) -> list[Any]:
        return decode(server.answer(encode(words, profile), "/peer", profile), profile)

    assert ask("set", "linear_tol", 0.05) == ["linear_tol set."]
    assert ask(Vocab("set"), "ang_speed_gain", 2) == ["ang_speed_gain set."]
    assert ask("set", "obstacle_stop", 1) == ["enable_obstacle_stop=true"]
    assert ask("set", "obstacle_avoidance", 0) == ["enable_obstacles_avoidance=false"]
    assert ask("set", "nonsense", 1) == ["Unknown set."]
    assert ask("get", "navigation_status") == ["navigation_status_idle"]
    assert ask("get") == ["Unknown get."]
    assert ask("reset_params") == ["params reset done"]
    assert ask("approach", 180, 0.2, 0.3) == ["approach command received"]
    assert goto.recorded == [
        ("SetLinearTolerance", 0.05), ("SetAngularSpeedGain", 2.0), ("SetObstacoleStop", True),
        ("SetObstacoleAvoidance", False), ("ResetParams",), ("Approach", 180.0, 0.2, 0.3),
    ]  # fmt: skip
    assert ask("approach", 180) == ["fail", "usage: approach DIRECTION SPEED TIME"]
    assert ask("set", "linear_tol", "far") == ["fail", "usage: set linear_tol NUMBER"]
    assert ask("approach", 0.0, 2.0, 1.0) == ["fail", "that is too fast"]
    assert ask("set", "max_ang_speed", 1)[0] == "fail"
    lines = ask("help")
    assert lines[:2] == ["many", "Available commands are:"]
    assert {"set linear_tol <m>", "set obstacle_stop <0/1>", "SetLinearTolerance", "stop_navigation_RPC"} <= set(lines)


def test_a_reply_may_begin_with_a_vocab_as_text(goto: Goto, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goto, "command", lambda _words: ["[many]", "[lines]"])
    answer = Server(goto).answer(encode(["help"], Profile.YARP3), "/peer")
    assert answer == encode([Vocab("many"), "[lines]"], Profile.YARP3)


def test_unknown_commands_are_rejected(goto: Goto) -> None:
    server = Server(goto, Generations(Generation.YARP_3_12))
    assert server.answer(encode(["nonsense"], Profile.YARP3), "/peer") == FAIL
    assert server.answer(encode([], Profile.YARP3), "/peer") == FAIL
    assert server.answer(b"\0\1\0\0", "/peer") == FAIL
    assert server.refused == 3


@pytest.mark.parametrize("generation", Generation)
def test_both_services_are_available_at_the_port(goto: Goto, generation: Generation) -> None:
    wire = Wire(Server(goto, Generations(generation)), generation)
    remote = RobotGotoMsgs(wire)
    assert remote.SetObstacoleStop(True)
    assert remote.Approach(90.0, 0.5, 1.0)
    assert goto.recorded == [("SetObstacoleStop", True), ("Approach", 90.0, 0.5, 1.0)]
    assert remote.GetNavigationStatus() == (OK, "navigation_status_idle")
    assert not remote.SetMaxAngularSpeed(1.0)
    navigation = INavigation2DMsgs(wire)
    assert navigation.get_navigation_status_RPC() == (OK, NavigationStatusEnum.navigation_status_idle)
