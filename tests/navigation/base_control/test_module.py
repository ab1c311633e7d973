"""BaseControl on a hub and on YARP, with a motor driver that follows its commands."""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Qos
from bridge.messages.json import from_json, to_json
from tests.peers.hub.modules import Place
from tests.support.faults import FaultProxy
from tests.support.wait import until
from yarp_compat.dev.basecontrol import MobileBaseVelocity, MobileBaseVelocityControl, Odometry2DClient
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Client, Reader, Writer

JOINTS = "sensor_msgs/msg/JointState"
TWIST = "geometry_msgs/Twist"
RADIUS, DISTANCE = 0.16416, 0.338
QUICK = {"max_linear_acc": 100.0, "max_angular_acc": 7000.0, "max_motor_vel": 3600.0}


class Wheels:
    """A motor driver on the hub that follows commands.

    Its ``velocity`` is zero from 0.1 s after the last command on; its joint angles follow that command without a limit.
    """

    def __init__(self, place: Place) -> None:
        self._hub, self._registry = place.far.hub, place.far.registry
        type_id = self._registry.ros2(JOINTS).type_id
        self._out = self._hub.publisher("/joint_states", JOINTS, type_id, Qos())
        self._in = self._hub.subscription("/wheel_command", JOINTS, type_id, Qos(depth=1), self._on_command)
        self.commanded, self._commanded_at = [0.0, 0.0], 0.0
        self.fastest = 0.0
        self.names: list[str] = ["mobile_base_l_wheel_joint", "mobile_base_r_wheel_joint"]
        self.stamped = True
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _on_command(self, sample: Any) -> None:
        message = to_json(self._registry, JOINTS, sample.data())
        assert message["name"] == self.names
        self.commanded, self._commanded_at = message["velocity"], time.monotonic()
        self.fastest = max(self.fastest, *map(abs, self.commanded))

    @property
    def velocity(self) -> tuple[float, float]:
        """The base's velocity: m/s, rad/s."""
        left, right = self.commanded if time.monotonic() - self._commanded_at < 0.1 else (0.0, 0.0)
        return (left + right) / 2 * RADIUS, (right - left) * RADIUS / DISTANCE

    def _run(self) -> None:
        angles, last = [0.0, 0.0], time.time()
        while not self._ending.wait(0.01):
            now = time.time()
            angles = [angle + rate * (now - last) for angle, rate in zip(angles, self.commanded, strict=True)]
            last = now
            stamp = {"sec": int(now), "nanosec": int(now % 1 * 1e9)} if self.stamped else {}
            message = {"header": {"stamp": stamp}, "name": self.names, "position": angles}
            self._out.put(from_json(self._registry, JOINTS, message))

    def close(self) -> None:
        self._ending.set()
        self._thread.join()


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as place:
        yield place


@pytest.fixture
def wheels(place: Place) -> Iterator[Wheels]:
    wheels = Wheels(place)
    yield wheels
    wheels.close()


def started(place: Place, **section: Any) -> None:
    place.worker.start(place.config(modules={"base_control": {"enabled": True, **QUICK, **section}}))


def drives(wheels: Wheels, x: float, turn: float) -> Callable[[], bool]:
    return lambda: wheels.velocity == pytest.approx((x, turn), abs=1e-6)


def twist(x: float, turn: float) -> dict[str, Any]:
    return {"linear": {"x": x, "y": 0.5, "z": 0.25}, "angular": {"x": 0.75, "y": 0.125, "z": turn}}


def test_hub_velocities_drive_the_base_and_silence_stops_it(place: Place, wheels: Wheels) -> None:
    odometry = place.far.subscribe("/odom", "nav_msgs/Odometry")
    frames = place.far.subscribe("/tf", "tf2_msgs/TFMessage")
    started(place)
    out = place.far.advertise("/cmd_vel", TWIST)

    def driven() -> bool:
        place.far.publish(out, twist(0.2, -0.5))
        return drives(wheels, 0.2, -0.5)()

    until(driven, "the wheels follow", 20)
    until(drives(wheels, 0.0, 0.0), "the wheels stop when no commands arrive", 10)
    last = lambda: place.far.wait(odometry, 1)[-1]  # noqa: E731
    assert (last()["header"]["frame_id"], last()["child_frame_id"]) == ("odom", "base_link")
    until(lambda: last()["pose"]["pose"]["position"]["x"] > 0.0, "odometry follows", 20)
    (transform,) = place.far.wait(frames, 1)[-1]["transforms"]
    assert (transform["header"]["frame_id"], transform["child_frame_id"]) == ("odom", "base_link")
    until(lambda: "/joint_states" in str(place.status("base_control")), "the status names the topic")
    place.worker.stop()
    until(lambda: wheels.commanded == [0.0, 0.0], "the last command to the wheels is zero", 10)


def test_invalid_commands_are_rejected_and_reported(place: Place, wheels: Wheels) -> None:
    started(place)
    out = place.far.advertise("/cmd_vel", TWIST)

    def refused() -> Any:
        place.far.publish(out, {"linear": {"x": 50.0}})
        return "above 10 m/s" in str(place.status("base_control"))

    until(refused, "the command is refused, and the status gives the reason", 20)
    assert wheels.velocity == (0.0, 0.0)


def test_missing_encoders_are_reported(place: Place) -> None:
    started(place)
    until(lambda: "no wheel encoders" in place.worker.health().text, "the module waits for encoders")


def test_a_failed_start_gives_its_reason_without_tracebacks(
    place: Place, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ini = tmp_path / "base.ini"
    ini.write_text("[ROBOT_GEOMETRY]\ngeom_r wide\n", encoding="utf-8")
    started(place, ini=ini)
    text = place.worker.health().text
    assert "geom_r" in text
    logged = [record for record in caplog.records if record.exc_info and "geom_r" in str(record.exc_info[1])]
    assert [record.getMessage() for record in logged] == []
    place.worker.stop()


def test_a_gamepad_drives_while_its_button_is_held(place: Place, wheels: Wheels) -> None:
    started(place)
    out = place.far.advertise("/joy", "sensor_msgs/Joy")
    held = {"axes": [0.5, 1.0], "buttons": [0, 0, 0, 0, 1]}
    until(lambda: (place.far.publish(out, held), drives(wheels, 0.3, math.radians(15))())[1], "the gamepad drives", 20)
    until(
        lambda: (place.far.publish(out, {**held, "buttons": []}), drives(wheels, 0.0, 0.0)())[1],
        "releasing the button stops the base",
        20,
    )


def test_the_base_stops_when_the_enable_button_is_released(place: Place, wheels: Wheels) -> None:
    started(place, inputs=[{"name": "pads", "timeout": 5.0, "joy": ["/joy"], "twist": ["/cmd_vel"]}])
    module: Any = place.worker.running("base_control").module
    module.base.inputs["pads"].timeout = 1000.0  # longer than the test waits
    out, other = place.far.advertise("/joy", "sensor_msgs/Joy"), place.far.advertise("/cmd_vel", TWIST)
    released = {"axes": [0.0, 1.0], "buttons": [0, 0, 0, 0, 0]}
    held = {**released, "buttons": [0, 0, 0, 0, 1]}
    until(lambda: (place.far.publish(out, held), drives(wheels, 0.3, 0.0)())[1], "the base drives", 20)
    place.far.publish(out, released)
    until(drives(wheels, 0.0, 0.0), "the base stops", 20)
    until(lambda: (place.far.publish(other, twist(0.2, 0.0)), drives(wheels, 0.2, 0.0)())[1], "the base drives", 20)

    def received() -> int:
        (joy,) = (topic for topic in place.answer("base_control")["topics"] if topic["topic"] == "/joy")
        return int(joy["messages"])

    before = received()
    place.far.publish(out, released)
    until(lambda: received() > before, "the message of the gamepad arrives", 20)
    assert module.base.inputs["pads"].last[0].x == 0.2, "a gamepad that does not drive commands nothing"


def test_halt_drops_commands(place: Place, wheels: Wheels) -> None:
    started(place, inputs=[{"name": "long", "timeout": 5.0, "twist": ["/cmd_vel"]}])
    module: Any = place.worker.running("base_control").module
    module.base.inputs["long"].timeout = 60.0  # longer than the test waits
    out = place.far.advertise("/cmd_vel", TWIST)
    until(lambda: (place.far.publish(out, twist(0.2, 0.0)), drives(wheels, 0.2, 0.0)())[1], "the base drives", 20)
    place.far.publish(out, twist(0.1, 0.0))
    until(drives(wheels, 0.1, 0.0), "the last command has arrived, so that none follows the halt", 20)
    answers = place.far.hub.ask("halt", {}, worker="base_control", timeout=20.0)
    assert [answer.value for answer in answers] == [{"halted": True}]
    until(drives(wheels, 0.0, 0.0), "the base stops", 40)


def test_yarp_ports_of_both_generations_are_served(place: Place, wheels: Wheels) -> None:
    started(place)
    names = place.names
    with NameServer(port=place.port, gc_seconds=0):
        until(lambda: names.query("/baseControl/rpc"), "the ports are registered", 20)
        until(lambda: "waiting" not in str(place.answer("base_control")["ports"]), "all ports are open", 20)
        with MobileBaseVelocityControl("/baseControl/input/command/rpc:i", naming=names) as base:
            until(
                lambda: (base.drive(0.1, 0.0, 90.0), drives(wheels, 0.1, math.radians(30.0))())[1],
                "the wheels follow a command sent over RPC",
                20,
            )

            def reported() -> bool:
                base.drive(0.1, 0.0, 90.0)  # valid for a fifth of a second
                outcome, *velocity = base.getLastVelocityCommand()
                assert velocity == pytest.approx([0.1, 0.0, 90.0] if outcome else [0.0, 0.0, 0.0])
                return bool(outcome)

            until(reported, "the command is reported while it is valid", 20)
            until(lambda: not base.getLastVelocityCommand()[0], "the command times out", 20)
            assert not base.applyVelocityCommand(math.nan, 0.0, 0.0)
        until(lambda: base_input(place) == "", "the command input is no longer active", 20)
        velocity = MobileBaseVelocity(0.05, 0.0, 20.0)
        with Writer("/test/command:o", naming=names) as writer:
            for port, content, wanted in (
                ("/baseControl/input/command/data:i", velocity, (0.05, math.radians(20.0))),
                ("/baseControl/control:i", [2, 180.0, 0.1, 10.0, 100.0], (-0.1, math.radians(10.0))),
                ("/baseControl/aux_control:i", velocity, (0.05, math.radians(20.0))),
                ("/baseControl/joystick1:i", [1, 0.0, 50.0, -100.0, 100.0], (0.15, math.radians(-30.0))),
            ):
                writer.connect(port)
                until(lambda c=content, w=wanted: (writer.write(c), drives(wheels, *w)())[1], f"by {port}", 20)
                connections.disconnect(names, "/test/command:o", port)
        until(drives(wheels, 0.0, 0.0), "the base stops again", 10)
        with Client("/baseControl/rpc", naming=names) as rpc:
            assert rpc.ask(["set_max_lin_vel", 0.2], timeout=10) == ["Max linear velocity set."]
            assert rpc.ask(["help"], timeout=10)[0] == "many"
            assert "unknown command" in str(rpc.ask(["dance"], timeout=10))
        with Odometry2DClient("/baseControl/odometry", naming=names) as odometry:
            reading = odometry.read()
            assert reading is not None
            assert reading[0].odom_x != 0.0
            assert reading[1] == pytest.approx(time.time(), abs=30.0)
            # repeated, because readings of the encoders from before the wheels stopped may still arrive
            until(
                lambda: odometry.resetOdometry() and odometry.getOdometry()[1].odom_x == 0.0,
                "the odometry is reset",
                20,
            )
            outcome, _, stamp = odometry.getOdometry()
            assert outcome
            assert stamp > reading[1]
        with Reader("/test/odometry:i", naming=names) as reader:
            for port, count in (("odometry:o", 9), ("odometer:o", 2), ("velocity:o", 2), ("odometry_vector:o", 3)):
                connections.connect(names, f"/baseControl/{port}", "/test/odometry:i")
                # the previous port's last message may still arrive
                until(lambda n=count: len(reader.read().values) == n, f"{port} has {count} numbers", 20)
                connections.disconnect(names, f"/baseControl/{port}", "/test/odometry:i")


def base_stale(place: Place) -> int:
    return int(place.answer("base_control")["stale"])


def base_input(place: Place) -> str:
    return str(place.answer("base_control")["input"])


def test_a_cut_link_stops_the_base_and_a_restored_one_brings_no_old_commands(place: Place, wheels: Wheels) -> None:
    started(place)
    with FaultProxy(place.hubs.port) as link:
        settings = HubSettings(router=f"tcp/127.0.0.1:{link.port}", zenoh={"mode": "client"}, shared_memory=False)
        with Hub.open(settings) as operator:
            registry = place.far.registry
            kind = "geometry_msgs/msg/Twist"
            stick = operator.publisher("/cmd_vel", kind, registry.ros2(kind).type_id, Qos(depth=1), priority="command")
            payload = from_json(registry, kind, twist(0.2, 0.0))
            until(lambda: (stick.put(payload), drives(wheels, 0.2, 0.0)())[1], "the base drives", 20)
            link.freeze()
            until(
                lambda: (stick.put(payload), drives(wheels, 0.0, 0.0)())[1], "the base stops while the link is cut", 10
            )
            stood = time.monotonic()
            until(lambda: time.monotonic() - stood > 1.0, "the messages held in the link are older than the time-out")
            before, wheels.fastest = base_stale(place), 0.0
            link.thaw()
            until(lambda: base_stale(place) > before, "waiting commands are dropped", 30)
            assert wheels.fastest == 0.0
            until(lambda: (stick.put(payload), drives(wheels, 0.2, 0.0)())[1], "the base drives again", 30)


@pytest.mark.parametrize("measured", [False, True], ids=["angles", "velocities"])
def test_burst_stamps_give_steady_odometry(place: Place, measured: bool) -> None:
    odometry = place.far.subscribe("/odom", "nav_msgs/Odometry", depth=1000)
    started(place)
    out = place.far.advertise("/joint_states", "sensor_msgs/JointState")
    names = ["arm_joint", "mobile_base_r_wheel_joint", "mobile_base_l_wheel_joint"]
    start, rate, readings = 1_760_000_000_000_000_000, 0.3 / RADIUS, 200
    until(lambda: place.far.publishers("/odom"), "base control publishes odometry", 20)

    def publish(stamp: int, angle: float) -> None:
        seconds, nanoseconds = divmod(stamp, 1_000_000_000)
        message = {
            "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}},
            "name": names,
            "position": [0.0, angle, angle],
            "velocity": [0.0, rate, rate] if measured else [],
        }
        place.far.publish(out, message)

    def received(stamp: int) -> bool:
        return any(stamp_ns(message) == stamp for message in place.far.wait(odometry, 1, 0.0)[-5:])

    # a repeated stamp would look as if the driver's clock had stopped
    early = itertools.count(start - 60_000_000_000, 10_000_000)
    until(lambda: (publish(next(early), 0.0), place.far.wait(odometry, 1, 0.2))[1], "readings become odometry", 20)
    for reading in range(readings):
        burst, within = divmod(reading, 4)
        stamp = start + burst * 40_000_000 + within * 400_000
        publish(stamp, rate * reading * 0.01)
        until(lambda stamp=stamp: received(stamp), "the reading becomes odometry", 20, 0.002)
    messages = [message for message in place.far.wait(odometry, 1) if stamp_ns(message) >= start]
    speeds = [message["twist"]["twist"]["linear"]["x"] for message in messages]
    assert max(speeds) <= 0.33
    assert min(speeds[readings // 2 :]) >= (0.3 - 1e-6 if measured else 0.25)
    stamps = [stamp_ns(message) for message in messages]
    assert stamps == sorted(set(stamps))
    assert messages[-1]["pose"]["pose"]["position"]["x"] == pytest.approx(0.3 * (readings - 1) * 0.01)


def test_odometry_works_without_stamps(place: Place, wheels: Wheels) -> None:
    wheels.stamped = False
    odometry = place.far.subscribe("/odom", "nav_msgs/Odometry")
    started(place)
    out = place.far.advertise("/cmd_vel", TWIST)
    last = lambda: place.far.wait(odometry, 1)[-1]  # noqa: E731
    until(
        lambda: (place.far.publish(out, twist(0.2, 0.0)), last()["twist"]["twist"]["linear"]["x"] > 0.15)[1],
        "odometry follows",
        20,
    )
    assert stamp_ns(last()) / 1e9 == pytest.approx(time.time(), abs=60.0)
    until(lambda: last()["twist"]["twist"]["linear"]["x"] == 0.0, "the odometry stops with the base", 20)


def stamp_ns(message: dict[str, Any]) -> int:
    stamp = message["header"]["stamp"]
    return int(stamp["sec"]) * 1_000_000_000 + int(stamp["nanosec"])
