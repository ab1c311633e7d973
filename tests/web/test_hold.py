"""Manual driving: the base moves while a page holds a direction."""

from __future__ import annotations

import socket
import time
from typing import Any
from unittest.mock import MagicMock

import pytest

from bridge.client.manual import ManualControl
from bridge.clock import steady
from bridge.hub.control import MANUAL_DRIVING_HALTED
from bridge.hub.errors import HubClosedError
from bridge.hub.wire.qos import Qos
from bridge.messages.json import to_json
from bridge.messages.velocities import TWIST, TWIST_STAMPED
from tests.peers.browser.page import TestPage
from tests.support.wait import until
from tests.web.conftest import Desk


class Base:
    """Receives velocities of one type on the hub, each with its time of arrival."""

    def __init__(self, desk: Desk, type_name: str = TWIST) -> None:
        self.received: list[tuple[float, float, float]] = []
        registry = desk.far.registry
        type_id = registry.ros2(type_name).type_id
        self.subscription = desk.far.hub.subscription("/cmd_vel", type_name, type_id, Qos(depth=10), self._on_message)
        self._registry, self._type_name = registry, type_name

    def _on_message(self, sample: Any) -> None:
        message = to_json(self._registry, self._type_name, sample.data())
        twist = message.get("twist", message)
        self.received.append((time.monotonic(), twist["linear"]["x"], twist["angular"]["z"]))

    def drives(self) -> bool:
        return bool(self.received) and self.received[-1][1:] != (0.0, 0.0)

    def stands(self) -> bool:
        return bool(self.received) and self.received[-1][1:] == (0.0, 0.0)


@pytest.fixture
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Extend the time after which a hold ends, and a late one is ignored: on a busy machine, 0.3 s pass unnoticed."""
    monkeypatch.setattr("bridge.web.verbs.hold.HOLD_SECONDS", 60.0)


def hold(page: TestPage, base: Base, seconds: float = 0.0, x: float = 0.1) -> None:
    """Hold a direction until the base drives, and for ``seconds`` afterwards."""
    end = time.monotonic() + 30
    while not base.drives():
        assert time.monotonic() < end, f"the base does not drive: {page.others}"
        page.send(op="hold", x=x, y=0.0, turn=0.0)
        page.read(0.05)
    until_ = time.monotonic() + seconds
    while time.monotonic() < until_:
        page.send(op="hold", x=x, y=0.0, turn=0.0)
        page.read(0.05)


def test_a_hold_drives_while_it_is_repeated(desk: Desk) -> None:
    base = Base(desk)
    with TestPage(desk.port) as page:
        hold(page, base, 0.6, x=5.0)
        # on a busy machine, zeros may be between the velocities
        assert {x for _, x, _ in base.received} - {0.0} == {0.3}, "the configuration limits the velocity"
        page.send(op="release")
        until(base.stands, "the base stands after the release")
        until(lambda: [x for _, x, _ in base.received[-5:]] == [0.0] * 5, "zero is repeated: a busy worker drops some")
        assert desk.console._hold.stopped.wait(20), "the repetition ends"


def test_a_hold_drives_in_the_form_of_the_base(desk: Desk) -> None:
    stamped = Base(desk, TWIST_STAMPED)
    with TestPage(desk.port) as page:
        hold(page, stamped)
        plain = Base(desk)
        stamped.subscription.close()
        hold(page, plain)
        page.send(op="release")
        until(plain.stands, "the base stands after the release")


@pytest.mark.parametrize("stamped", [True, False])
def test_a_hold_drives_in_the_configured_form(desk: Desk, stamped: bool) -> None:
    desk.open_with(navigation={"planner": "nav2", "stamped": stamped})
    bases = {name: Base(desk, name) for name in (TWIST, TWIST_STAMPED)}
    with TestPage(desk.port) as page:
        hold(page, bases.pop(TWIST_STAMPED if stamped else TWIST))
    assert [base.received for base in bases.values()] == [[]]


@pytest.mark.parametrize("how", ["silent", "cut", "closed"])
def test_a_page_that_closes_stops_the_base(desk: Desk, how: str) -> None:
    base = Base(desk)
    with TestPage(desk.port) as page:
        hold(page, base)
        if how == "cut":
            page.socket.socket.shutdown(socket.SHUT_RDWR)
        elif how == "closed":
            page.socket.close()
        until(base.stands, "the base stands")


@pytest.mark.usefixtures("patience")
def test_a_hold_is_refused_without_a_velocity_topic(desk: Desk) -> None:
    desk.open_with(navigation={"planner": "nav2", "velocity": ""})
    with TestPage(desk.port) as page:
        page.send(op="hold", x=0.1, y=0.0, turn=0.0)
        page.until(page.errors, "the hold is refused")
        assert page.errors() == ["no velocity topic is configured (navigation.velocity)"]
        assert page.call("ping")["ok"]


@pytest.mark.usefixtures("patience")
def test_one_page_drives_at_a_time(desk: Desk) -> None:
    base = Base(desk)
    with TestPage(desk.port) as first, TestPage(desk.port) as other:
        hold(first, base)
        stop = time.monotonic() + 30
        while not other.errors():
            assert time.monotonic() < stop
            first.send(op="hold", x=0.1, y=0.0, turn=0.0)
            first.read(0.02)
            other.send(op="hold", x=-0.1, y=0.0, turn=0.0)
            other.read(0.05)
        assert "drives manually" in other.errors()[0]
        assert all(x >= 0.0 for _, x, _ in base.received)


@pytest.mark.usefixtures("patience")
def test_a_hold_is_refused_while_a_person_drives_with_another_program(desk: Desk) -> None:
    base, other = Base(desk), ManualControl(desk.far.hub, "/cmd_vel")
    with TestPage(desk.port) as page:
        other.begin("anna (foxglove)")
        graph = desk.console.host.node.hub.graph
        until(lambda: graph.drivers("/cmd_vel"), "the console knows the driver")
        page.send(op="hold", x=0.1, y=0.0, turn=0.0)
        page.until(page.errors, "the hold is refused")
        assert (page.errors(), base.received) == (["anna (foxglove) drives manually"], [])
        other.end()
        until(lambda: not graph.drivers("/cmd_vel"), "the console knows that control is free")
        page.send(op="hold", x=0.1, y=0.0, turn=0.0)
        page.until(lambda: len(page.errors()) > 1 or base.drives(), "the control is still pressed")
        assert (page.errors()[1:], base.received) == (["release the control first"], [])
        page.send(op="release")
        hold(page, base)
        until(lambda: other.rival().endswith("(web) drives manually"), "the other program is refused meanwhile")
        page.send(op="release")
        until(lambda: not other.rival(), "control is free after the release")


def test_a_refused_control_is_not_released_by_silence(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page reports a release, so silence shows that its messages do not arrive, or that this process stalled."""
    driving, loop, other = desk.console._hold, desk.console.host.loop, ManualControl(desk.far.hub, "/cmd_vel")
    person, pressed = MagicMock(who="anna"), steady()
    other.begin("bert (foxglove)")
    graph = desk.console.host.node.hub.graph
    until(lambda: graph.drivers("/cmd_vel"), "the console knows the driver")
    for later, reason in ((0.0, "bert (foxglove) drives manually"), (60.0, "release the control first")):
        clock = lambda seconds=later: steady() + seconds  # noqa: E731
        monkeypatch.setattr("bridge.web.verbs.hold.steady", clock)
        loop.call(lambda now=clock: driving.hold(person, 0.1, 0.0, 0.0, now(), pressed))
        assert person.refuse.call_args.args == (reason,)
        other.end()
        until(lambda: not graph.drivers("/cmd_vel"), "the console knows that control is free")
    assert not driving._control.held


@pytest.mark.usefixtures("patience")
def test_zero_is_not_repeated_against_the_next_driver(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.web.verbs.hold.STOP_SECONDS", 3600.0)
    base, other = Base(desk), ManualControl(desk.far.hub, "/cmd_vel")
    with TestPage(desk.port) as page:
        hold(page, base)
        page.send(op="release")
        until(base.stands, "the base stands")
        assert not desk.console._hold.stopped.is_set()
        other.begin("anna (foxglove)")
        assert desk.console._hold.stopped.wait(20), "the repetition ends"


@pytest.mark.usefixtures("patience")
def test_a_hold_is_refused_while_a_planner_drives(desk: Desk) -> None:
    base = Base(desk)
    status = desk.far.advertise("/navigation/status", "midspan_msgs/NavigationStatus", latched=True)
    desk.far.publish(status, {"state": "moving"})
    with TestPage(desk.port) as page:
        page.watch("driving")
        page.value("driving", lambda value: value and value["state"] == "moving")
        page.send(op="hold", x=0.1, y=0.0, turn=0.0)
        page.until(page.errors, "the hold is refused")
        assert page.errors() == ["nav2 drives; pause or stop it first"]
        desk.far.publish(status, {"state": "idle"})
        page.value("driving", lambda value: value and value["state"] == "idle")
        page.send(op="release")
        hold(page, base)
        desk.far.publish(status, {"state": "moving"})
        page.value("driving", lambda value: value and value["state"] == "moving")
        page.send(op="hold", x=0.1, y=0.0, turn=0.0)
        until(base.stands, "the hold ends when a planner starts")


@pytest.mark.parametrize(("x", "shown"), [("1e300", "1e+300"), ("1e999", "inf"), ('"1"', "'1'")])
def test_a_hold_out_of_range_is_refused_with_its_limits(desk: Desk, x: str, shown: str) -> None:
    with TestPage(desk.port) as page:
        page.socket.send(f'{{"op": "hold", "x": {x}, "y": 0, "turn": 0}}')
        page.until(page.errors, "the hold is refused")
        limits = "must be a number between -1,000,000,000 and 1,000,000,000"
        assert page.errors() == [f"hold: x {limits}, not {shown}"]


@pytest.mark.usefixtures("patience")
def test_a_page_must_release_after_a_stop_of_another_page(desk: Desk) -> None:
    base = Base(desk)
    with TestPage(desk.port) as page, TestPage(desk.port) as other:
        hold(page, base)
        other.call("stop")
        page.until(lambda: "the robot was stopped" in page.errors(), "the page learns of the stop")
        page.send(op="hold", x=0.1, y=0.0, turn=0.0)
        page.until(lambda: len(page.errors()) > 1, "a control that is still pressed does not drive")
        assert page.errors()[-1] == "the robot was stopped; release the control first"
        until(base.stands, "the base stands")
        page.send(op="release")
        hold(page, base)


@pytest.mark.usefixtures("patience")
def test_a_halt_on_the_hub_ends_a_hold(desk: Desk) -> None:
    base = Base(desk)
    with TestPage(desk.port) as page:
        hold(page, base)
        assert MANUAL_DRIVING_HALTED in [answer.value for answer in desk.far.hub.ask("halt", {}, timeout=20.0)]
        until(base.stands, "the base stands")
        page.send(op="hold", x=0.1, y=0.0, turn=0.0)
        page.until(
            lambda: any("release the control first" in error for error in page.errors()), "the control no longer drives"
        )


@pytest.mark.usefixtures("patience")
def test_a_hold_does_not_begin_while_the_console_closes(desk: Desk) -> None:
    """The server's thread may go on for longer than the console waits for it."""
    base, driving, loop = Base(desk), desk.console._hold, desk.console.host.loop
    with TestPage(desk.port) as page:
        hold(page, base)
        loop.call(driving.end)
        assert driving.stopped.wait(20)
        page.send(op="release")
        page.send(op="hold", x=0.1, y=0.0, turn=0.0)
        assert page.call("ping")["ok"], "the console has received the hold"
        loop.call(lambda: None)
        assert driving.stopped.is_set()


@pytest.mark.usefixtures("patience")
def test_a_hold_does_not_outlast_a_suspended_machine(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """CLOCK_MONOTONIC stands still meanwhile."""
    base = Base(desk)
    with TestPage(desk.port) as page:
        hold(page, base)
        monkeypatch.setattr("bridge.web.verbs.hold.steady", lambda: steady() + 3600.0)
        until(base.stands, "the base stands")


def test_a_stop_goes_to_the_gateway_and_ends_a_hold(desk: Desk) -> None:
    stops = desk.far.serve("/navigation/stop", "std_srvs/Trigger", reply={"success": True, "message": "stands"})
    base = Base(desk)
    with TestPage(desk.port) as page:
        hold(page, base)
        reply: dict[str, Any] = {}

        def stopped() -> bool:
            reply.update(page.call("stop"))
            return bool(reply["ok"])

        until(stopped, "the gateway receives the call")
        assert reply["value"] == "stands"
        until(base.stands, "the hold has ended")
    assert stops is not None


def fail(*_arguments: object) -> None:
    raise HubClosedError("this node of the hub is closed")


@pytest.mark.usefixtures("patience")
@pytest.mark.parametrize("at", ["begin", "stop"])
def test_others_can_drive_after_a_hold_that_cannot_be_published(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    driving, loop, other = desk.console._hold, desk.console.host.loop, ManualControl(desk.far.hub, "/cmd_vel")
    person = MagicMock(who="anna")

    def hold_now() -> None:
        driving.hold(person, 0.1, 0.0, 0.0, steady(), steady())

    with monkeypatch.context() as patch:
        if at == "begin":
            patch.setattr("bridge.web.verbs.hold.velocity_publisher", fail)
            with pytest.raises(HubClosedError):
                loop.call(hold_now)
        else:
            loop.call(hold_now)
            until(other.rival, "the other program is refused meanwhile")
            patch.setattr(driving, "_publish", fail)
            with pytest.raises(HubClosedError):
                loop.call(lambda: driving.release(person))
        assert not driving._control.held
    until(lambda: not other.rival(), "control is free")
    loop.call(hold_now)
    until(other.rival, "the person drives when publishing works again")
