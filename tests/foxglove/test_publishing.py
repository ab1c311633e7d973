"""Clients' messages are published unchanged, if the role permits; velocities only while they are repeated."""

from __future__ import annotations

import contextlib
import json
import threading
from typing import Any
from unittest.mock import MagicMock

import pytest

from bridge.client.manual import ManualControl
from bridge.foxglove import publishing
from bridge.foxglove.presses import Press
from bridge.hub.control import MANUAL_DRIVING_HALTED
from bridge.messages.json import from_json
from bridge.web.verbs import hold
from navigation.status import State
from tests.foxglove.conftest import Desk
from tests.peers.browser.foxglove_app import App
from tests.support.wait import until

DRIVE: dict[str, Any] = {"foxglove": {"drive": True}}
TWIST = "geometry_msgs/msg/Twist"


@pytest.fixture
def driven(desk: Desk) -> Desk:
    desk.open_with(**DRIVE)
    return desk


def velocity(x: float, turn: float = 0.0) -> bytes:
    return json.dumps({"linear": {"x": x}, "angular": {"z": turn}}).encode()


def wait_for_status(app: App, text: str) -> dict[str, Any]:
    """Wait for a status message that contains a text."""
    return app.until(
        lambda: next((entry for entry in app.texts if text in entry.get("message", "")), None),
        f"a status contains {text}",
    )


@pytest.mark.parametrize("type_name", ["std_msgs/msg/String", "std_msgs/String"])
def test_json_and_cdr_reach_the_hub(driven: Desk, type_name: str) -> None:
    subscription = driven.far.subscribe("/said", "std_msgs/String")
    with driven.app() as app:
        as_json, as_cdr = app.advertise("/said", type_name, "json"), app.advertise("/said", type_name, "cdr")
        until(lambda: len(driven.far.publishers("/said")) == 2, "both publishers are on the hub")
        app.publish(as_json, b'{"data": "one"}')
        app.publish(as_cdr, from_json(driven.far.registry, "std_msgs/msg/String", {"data": "two"}))
        assert driven.far.wait(subscription, 2) == [{"data": "one"}, {"data": "two"}]
        (qos, _) = (end.qos for end in driven.far.publishers("/said"))
        assert not qos.latched

        def counts() -> list[tuple[str, int]]:
            ends = [entry for entry in driven.status()["topics"] if entry["end"] == "publisher"]
            return [(entry["by"], entry["messages"]) for entry in ends]

        until(lambda: counts() == [("127.0.0.1", 1)] * 2, "each message is counted, after it was published")
        app.unadvertise(as_json)
        until(lambda: len(driven.far.publishers("/said")) == 1, "one publisher is withdrawn")
    until(lambda: not driven.far.publishers("/said"), "the other publisher ends with its client")


def test_the_last_message_before_the_end_of_a_channel_is_published(driven: Desk) -> None:
    subscription = driven.far.subscribe("/said", "std_msgs/String")
    busy, go_on = threading.Event(), threading.Event()
    with driven.app() as app:
        number = app.advertise("/said", "std_msgs/msg/String", "json")
        until(lambda: driven.far.publishers("/said"), "the topic is published")
        app.publish(number, b'{"data": "first"}')
        driven.far.wait(subscription, 1)
        driven.live.host.loop.post(lambda: (busy.set(), go_on.wait(20.0)))
        assert busy.wait(20.0)
        app.publish(number, b'{"data": "last"}')
        app.unadvertise(number)
        events = driven.live._events
        until(lambda: not any(c.topic == "/said" for c in [*events._advertised.values()]), "the channel has ended")
        go_on.set()
        assert driven.far.wait(subscription, 2) == [{"data": "first"}, {"data": "last"}]
    until(lambda: not driven.far.publishers("/said"), "the publisher is withdrawn")


def test_a_watching_client_publishes_nothing(desk: Desk) -> None:
    with desk.app() as app:
        app.advertise("/said", "std_msgs/msg/String", "json")
        wait_for_status(app, "does not support clientPublish")
        assert not desk.far.publishers("/said")


def test_invalid_channels_and_messages_are_reported(desk: Desk) -> None:
    rules = [{"topic": "/steering", "to": "ros1", "priority": "command"}]
    desk.open_with(**DRIVE, routing={"rules": rules})
    subscription = desk.far.subscribe("/n", "std_msgs/Int8")
    with desk.app() as app:
        for topic, type_name, encoding, reason in (
            ("/a", "std_msgs/msg/String", "protobuf", "the encoding must be cdr or json"),
            ("a b", "std_msgs/msg/String", "json", "not a topic name"),
            ("/_midspan/a", "std_msgs/msg/String", "json", "not a topic name"),
            ("/a", "robot_msgs/msg/Mood", "json", "robot_msgs/msg/Mood"),
            ("/a", "no type", "json", "'no type' is not a type name"),
            ("/wheels/cmd_vel", TWIST, "json", "velocities are accepted only on /cmd_vel"),
            ("/anything", "geometry_msgs/msg/TwistStamped", "json", "velocities are accepted only on /cmd_vel"),
            ("/steering", "std_msgs/msg/Float64", "json", "velocities are accepted only on /cmd_vel"),
        ):
            app.advertise(topic, type_name, encoding)
            wait_for_status(app, reason)
        assert not desk.far.publishers("/a")
        number = app.advertise("/n", "std_msgs/msg/Int8", "json")
        until(lambda: desk.far.publishers("/n"), "the topic is published")
        for data, reason in (
            (b"{", "the message is not JSON"), (b"[" * 100_000, "the message is not JSON"), (b"3", "not a JSON object"),
            (b'{"data": 300}', "data must be int8, not 300"), (b'{"dat": 3}', "has no field 'dat'"),
            (b"\xff", "the message is not JSON"),
        ):  # fmt: skip
            app.publish(number, data)
            wait_for_status(app, reason)
        app.publish(number, b'{"data": 3}')
        assert desk.far.wait(subscription, 1) == [{"data": 3}]
        binary = app.advertise("/n", "std_msgs/msg/Int8", "cdr")
        until(lambda: len(desk.far.publishers("/n")) == 2, "the second publisher is on the hub")
        app.publish(binary, b"\0\1\0")
        (texts,) = (
            entry
            for entry in app.until(lambda: bad(desk), "the invalid message is counted")
            if entry["drops"]["bad"] == 1
        )
        assert texts["error"]


def bad(desk: Desk) -> list[dict[str, Any]]:
    return [entry for entry in desk.status()["topics"] if entry["end"] == "publisher" and entry["drops"]["bad"] == 1]


def test_a_velocity_expires_and_zero_follows(driven: Desk) -> None:
    subscription = driven.far.subscribe("/cmd_vel", "geometry_msgs/Twist")
    with driven.app() as app:
        number = app.advertise("/cmd_vel", TWIST, "json")
        first = drive_until_received(driven, app, number, subscription)
        assert first["linear"]["x"] == 0.3, "the velocity is limited as in the console (web.speed)"
        until(lambda: driven.far.wait(subscription, 1)[-1]["linear"]["x"] == 0.0, "a zero velocity follows the silence")
        count = len(driven.far.wait(subscription, 1))
        until(lambda: len(driven.far.wait(subscription, 1)) >= count + 5, "zero is repeated")
        assert driven.live._driving.stopped.wait(20), "the repetition ends"
        (end,) = until(lambda: driven.far.publishers("/cmd_vel"), "the client's publisher is in the graph")
        assert not end.qos.latched
        late = driven.far.subscribe("/cmd_vel", "geometry_msgs/Twist")
        drive_until_received(driven, app, number, late)
        assert len(driven.far.wait(subscription, count + 1)) > count


def drive_until_received(desk: Desk, app: App, number: int, subscription: int) -> dict[str, Any]:
    def receive() -> dict[str, Any] | None:
        app.publish(number, velocity(2.0))
        moving = [entry for entry in desk.far.wait(subscription, 1, 0.05) if entry["linear"]["x"] > 0.0]
        return moving[-1] if moving else None

    return until(receive, "a velocity is received", 10)


def drive_until_refused(app: App, number: int, reason: str) -> None:
    def refused() -> bool:
        app.publish(number, velocity(0.1))
        app.read()
        return any(reason in entry.get("message", "") for entry in app.texts)

    until(refused, f"driving is refused: {reason}")


@pytest.mark.usefixtures("patience")
def test_a_halt_on_the_hub_ends_driving_until_the_control_is_released(driven: Desk) -> None:
    subscription = driven.far.subscribe("/cmd_vel", "geometry_msgs/Twist")
    with driven.app() as app:
        number = app.advertise("/cmd_vel", TWIST, "json")
        drive_until_received(driven, app, number, subscription)
        assert MANUAL_DRIVING_HALTED in [answer.value for answer in driven.far.hub.ask("halt", {}, timeout=20.0)]
        drive_until_refused(app, number, "release the control first")
        until(lambda: driven.far.wait(subscription, 1)[-1]["linear"]["x"] == 0.0, "zero is commanded")


@pytest.fixture
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Extend the times after which a velocity ends and a control counts as released: a busy app may be silent."""
    for module, name in ((hold, "HOLD_SECONDS"), (publishing, "RELEASED_SECONDS")):
        monkeypatch.setattr(module, name, 60.0)


@pytest.mark.usefixtures("patience")
@pytest.mark.parametrize("stopped", ["before", "after", "refused"])
@pytest.mark.parametrize("end", ["channel", "connection", "new connection first", "restart"])
def test_a_control_that_is_held_during_a_reconnection_is_not_pressed_anew(driven: Desk, end: str, stopped: str) -> None:
    """The app reconnects by itself, and goes on sending the velocity of a control that is still held."""
    subscription = driven.far.subscribe("/cmd_vel", "geometry_msgs/Twist")

    def stop() -> None:
        if stopped == "refused":
            other = ManualControl(driven.far.hub, "/cmd_vel")
            other.begin("anna (web)")
            until(lambda: driven.live.host.node.hub.graph.drivers("/cmd_vel"), "the server knows the driver")
            drive_until_refused(app, number, "anna (web) drives manually")
            other.end()
            until(lambda: not driven.live.host.node.hub.graph.drivers("/cmd_vel"), "control is free")
        else:
            until(
                lambda: MANUAL_DRIVING_HALTED in [a.value for a in driven.far.hub.ask("halt", {}, timeout=20.0)],
                "manual driving is halted",
            )

    with driven.app() as app, contextlib.ExitStack() as stack:
        number = app.advertise("/cmd_vel", TWIST, "json")
        if stopped != "refused":
            drive_until_received(driven, app, number, subscription)
        if stopped != "after":
            stop()
        if end == "restart":
            driven.open_with(**DRIVE)
        again = app if end == "channel" else stack.enter_context(driven.app())
        if end == "channel":
            app.unadvertise(number)
        elif end == "connection":
            app.close()
        if stopped == "after":
            stop()
        if stopped != "refused":  # a velocity from before the stop may still be on its way
            until(lambda: driven.far.wait(subscription, 1)[-1]["linear"]["x"] == 0.0, "zero is commanded")
        count = len(driven.far.wait(subscription, 0, 0.0))
        number = again.advertise("/cmd_vel", TWIST, "json")
        drive_until_refused(again, number, "release the control first")
        assert not [entry for entry in driven.far.wait(subscription, 0, 0.0)[count:] if entry["linear"]["x"]]
        again.publish(number, velocity(0.0))
        drive_until_received(driven, again, number, subscription)


@pytest.mark.usefixtures("patience")
def test_driving_is_refused_while_a_person_drives_with_another_program(driven: Desk) -> None:
    subscription = driven.far.subscribe("/cmd_vel", "geometry_msgs/Twist")
    other = ManualControl(driven.far.hub, "/cmd_vel")
    with driven.app() as app:
        number = app.advertise("/cmd_vel", TWIST, "json")
        other.begin("anna (web)")
        until(lambda: driven.live.host.node.hub.graph.drivers("/cmd_vel"), "the server knows the driver")
        drive_until_refused(app, number, "anna (web) drives manually")
        assert driven.far.wait(subscription, 1, 0.1) == []
        other.end()
        drive_until_refused(app, number, "release the control first")
        assert driven.far.wait(subscription, 1, 0.1) == []
        app.publish(number, velocity(0.0))
        drive_until_received(driven, app, number, subscription)


def test_a_stall_of_the_server_does_not_release_a_control() -> None:
    """The app has no message for a released control, and its messages of that time have not been read yet."""
    stalls, driving, coder = MagicMock(), MagicMock(), MagicMock()
    coder.fields.return_value = {"linear": {"x": 0.1, "y": 0.0}, "angular": {"z": 0.0}}
    client = publishing.ClientVelocity(driving, MagicMock(), MagicMock(), coder, stalls)
    # when messages arrive, whether this process stalled just before, and when the control counts as pressed
    for arrived, stalled, pressed in (
        (10, False, 10),
        (11, False, 10),
        (15, True, 10),
        (16, False, 10),
        (18, False, 18),
    ):
        stalls.hung.return_value = stalled
        client.send(MagicMock(data=b"", arrived=float(arrived)))
        assert driving.hold.call_args.args[-1] == float(pressed)


def test_a_control_that_is_pressed_after_a_reconnection_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pause since the new channel was opened, or zero, shows that the control was released."""
    stalls, coder = MagicMock(), MagicMock()
    stalls.hung.return_value = False
    driving = MagicMock()

    def pressed(client: publishing.ClientVelocity, x: float, arrived: float) -> float:
        coder.fields.return_value = {"linear": {"x": x, "y": 0.0}, "angular": {"z": 0.0}}
        client.send(MagicMock(data=b"", arrived=arrived))
        at: float = driving.hold.call_args.args[-1]
        return at

    def opened(now: float, before: Press | None) -> publishing.ClientVelocity:
        monkeypatch.setattr(publishing, "steady", lambda: now)
        return publishing.ClientVelocity(driving, MagicMock(), MagicMock(), coder, stalls, before)

    first = opened(10.0, None)
    assert pressed(first, 0.1, 10.0) == 10.0
    assert pressed(opened(70.0, first.press), 0.1, 71.0) == 10.0, "no pause while the app was not connected"
    assert pressed(opened(70.0, first.press), 0.1, 72.0) == 72.0
    second = opened(70.0, first.press)
    assert (pressed(second, 0.0, 70.5), pressed(second, 0.1, 71.0), pressed(second, 0.1, 72.0)) == (70.5, 71.0, 71.0)
    assert pressed(first, 0.0, 72.0) == 72.0
    assert pressed(opened(73.0, first.press), 0.1, 73.0) == 73.0
    assert pressed(opened(73.0, None), 0.1, 73.0) == 73.0


@pytest.mark.parametrize("end", ["unadvertise", "leave", "cut", "the server stops"])
def test_zero_is_commanded_when_the_driver_leaves(driven: Desk, end: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hold, "HOLD_SECONDS", 60.0)  # so that the silence does not stop the base
    subscription = driven.far.subscribe("/cmd_vel", "geometry_msgs/Twist")
    with driven.app(close_timeout=0.1) as app:
        number = app.advertise("/cmd_vel", TWIST, "json")
        drive_until_received(driven, app, number, subscription)
        if end == "unadvertise":
            app.unadvertise(number)
        elif end == "leave":
            app.close()
        elif end == "cut":
            app.socket.socket.close()
        else:
            driven.live.host.loop.call(driven.live.stop_publishing)
        until(lambda: driven.far.wait(subscription, 1)[-1]["linear"]["x"] == 0.0, "a zero velocity is commanded")


def test_one_client_drives_at_a_time_and_none_against_a_planner(desk: Desk) -> None:
    desk.open_with(**DRIVE, navigation={"planner": "nav2"})
    subscription = desk.far.subscribe("/cmd_vel", "geometry_msgs/Twist")
    with desk.app() as app, desk.app() as other:
        number, second = app.advertise("/cmd_vel", TWIST, "json"), other.advertise("/cmd_vel", TWIST, "json")
        drive_until_received(desk, app, number, subscription)

        def refused() -> bool:
            """Publish from both; the first is refused if it was late, so that the second one drives."""
            app.publish(number, velocity(0.1))
            other.publish(second, velocity(0.2))
            app.read()
            other.read()
            return any("drives manually" in entry.get("message", "") for entry in (*app.texts, *other.texts))

        until(refused, "one of the clients is refused")
        status = desk.far.advertise("/navigation/status", "midspan_msgs/NavigationStatus", latched=True)
        desk.far.publish(status, {"state": State.MOVING.value})
        drive_until_refused(app, number, "nav2 drives")
        until(lambda: desk.far.wait(subscription, 1)[-1]["linear"]["x"] == 0.0, "a zero velocity was commanded")


def test_invalid_velocities_are_refused(driven: Desk) -> None:
    subscription = driven.far.subscribe("/cmd_vel", "geometry_msgs/Twist")
    with driven.app() as app:
        number = app.advertise("/cmd_vel", TWIST, "json")
        app.publish(number, b'{"linear": {"x": "NaN"}}')
        wait_for_status(app, "a velocity must be finite")
        app.publish(number, b'{"linear": 3}')
        wait_for_status(app, "linear")
        assert driven.far.wait(subscription, 1, 0.1) == []
