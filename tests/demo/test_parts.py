"""The demo's own logic: the simulated robot, the listeners' ears, the checks."""

from __future__ import annotations

import math
import signal
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest

from bridge.demo import camera, place, requirements, topics, traces
from bridge.demo.base import TIMEOUT, Base
from bridge.demo.checks import ROS1, ROS2, YARP, YARP_TEXT, ZENOH, Drive, evaluate, promises
from bridge.demo.child import guarded
from bridge.demo.floor_plan import RESOLUTION, FloorPlan
from bridge.demo.place import Place
from bridge.demo.report import Ear

ROOT = Path(__file__).parents[2]
MAP = "180 x 105 cells, CRC 00000000"
DRIVE = Drive(ROS2, (0.3, 0.0), (0.0, 0.0, 0.0), (0.8, 0.0, 0.0), 25, 25, (0.0, 0.0), seen=True)


def free(_x: float, _y: float) -> bool:
    return True


def test_base_moves_by_its_command_and_stops_when_the_commander_falls_silent() -> None:
    base = Base(free)
    base.command(0.4, 0.0, 0.0)
    for tick in range(40):
        base.step(0.05, tick * 0.05)
    assert base.x == pytest.approx(0.4 * TIMEOUT, abs=0.4 * 0.06)
    assert (base.y, base.linear, base.angular) == (0.0, 0.0, 0.0)


def test_base_turns_and_keeps_its_heading_between_minus_pi_and_pi() -> None:
    base = Base(free)
    for tick in range(100):
        base.command(0.0, 1.0, tick * 0.05)
        base.step(0.05, tick * 0.05)
    assert base.yaw == pytest.approx(5.0 - math.tau)


@pytest.mark.parametrize("command", [(math.nan, 0.0), (0.0, math.inf)])
def test_base_does_not_obey_what_is_not_a_number(command: tuple[float, float]) -> None:
    base = Base(free)
    base.command(*command, 0.0)
    base.step(0.05, 0.0)
    assert (base.x, base.y, base.yaw) == (0.0, 0.0, 0.0)


def test_base_stops_at_a_wall() -> None:
    plan = FloorPlan()
    base = Base(lambda x, y: not plan.occupied(x, y))
    for tick in range(2000):
        base.command(0.5, 0.0, tick * 0.05)
        base.step(0.05, tick * 0.05)
    assert base.x > 1.0
    assert plan.cast(base.x, base.y, 0.0, 10.0) == pytest.approx(0.2, abs=0.05)


def test_rays_end_where_the_grid_is_occupied() -> None:
    plan, cells = FloorPlan(), FloorPlan().occupancy()
    for degrees in range(0, 360, 7):
        angle = math.radians(degrees)
        distance = plan.cast(0.0, 0.0, angle, 20.0)
        inside = [(distance + d) for d in (-0.01, 0.01)]
        hits = []
        for r in inside:
            column = int((r * math.cos(angle) - plan.origin[0]) / RESOLUTION)
            row = int((r * math.sin(angle) - plan.origin[1]) / RESOLUTION)
            hits.append(cells[row * plan.size[0] + column])
        assert hits == [0, 100], degrees


def test_picture_is_whole_and_shows_a_near_wall_higher_than_a_far_one() -> None:
    plan = FloorPlan()
    ceilings = []
    for yaw in (0.0, math.pi / 2):
        picture = camera.picture(plan, 0.0, 0.0, yaw)
        assert len(picture) == camera.WIDTH * camera.HEIGHT * 3
        ceilings.append(picture.count(bytes((70, 90, 110))))
    assert plan.cast(0.0, 0.0, 0.0, 10.0) > plan.cast(0.0, 0.0, math.pi / 2, 10.0)
    assert ceilings[0] > ceilings[1]


def test_ear_tells_a_message_that_came_twice() -> None:
    ear = Ear()
    for key in (1, 2, 2, None, None):
        ear.hear(key, "text")
    assert ear.as_dict() == {"count": 5, "repeated": 1, "detail": "text"}


def reports() -> dict[str, dict[str, Any]]:
    """What the programs report when everything crossed."""
    greetings = {
        topics.FROM_ROS1: "hello 9 from ROS 1",
        topics.FROM_ROS2: "hello 9 from ROS 2",
        topics.FROM_ZENOH: "hello 9 from zenoh",
        topics.FROM_YARP: "hello 9 from YARP",
    }
    robot = {promise.topic: promise.reads for promise in promises(MAP)} | greetings

    def heard(reads: dict[str, str]) -> dict[str, Any]:
        return {"heard": {topic: {"count": 100, "repeated": 0, "detail": text} for topic, text in reads.items()}}

    return {ROS1: {**heard(greetings), "map": MAP}, **{name: heard(robot) for name in (ROS2, ZENOH, YARP)}}


def failed(told: dict[str, dict[str, Any]], *drives: Drive) -> set[tuple[str, str, str]]:
    return {(c.name, c.target, c.topic) for c in evaluate(told, drives) if not c.ok}


ALL = (DRIVE, *(replace(DRIVE, source=name) for name in (ZENOH, YARP, YARP_TEXT)))


def test_checks_hold_when_all_crossed() -> None:
    assert failed(reports(), *ALL) == set()


@pytest.mark.parametrize(
    ("topic", "change", "name"),
    [
        (topics.SCAN, {"count": 3}, "laser scan"),
        (topics.MAP, {"detail": "180 x 105 cells, CRC ffffffff"}, "map, joined late"),
        (topics.TF_STATIC, {"detail": "camera, laser"}, "static transforms, joined late"),
        (topics.ODOM, {"repeated": 1}, "odometry"),
    ],
)
def test_checks_name_what_is_missing_wrong_or_doubled(topic: str, change: dict[str, Any], name: str) -> None:
    told = reports()
    told[ROS2]["heard"][topic] |= change
    assert failed(told, *ALL) == {(name, ROS2, topic)}


def test_checks_see_an_echo() -> None:
    told = reports()
    told[ROS1]["heard"][topics.FROM_ROS1]["repeated"] = 2
    assert ("no echo", ROS1, topics.FROM_ROS1) in failed(told, *ALL)


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"after": (0.05, 0.0, 0.0)}, {"drive", "silence stops it"}),
        ({"velocity": (0.3, 0.0)}, {"silence stops it"}),
        ({"seen": False}, {"drive seen"}),
    ],
)
def test_checks_see_a_robot_that_does_not_obey(change: dict[str, Any], names: set[str]) -> None:
    told = evaluate(reports(), (replace(DRIVE, **change), *ALL[1:]))
    assert {check.name for check in told if not check.ok} == names


def test_no_report_and_no_drive_is_no_success() -> None:
    checks = evaluate({ROS1: {}, ROS2: {}, ZENOH: {}, YARP: {}}, ())
    assert not any(check.ok for check in checks)


def test_places_meet_nobody() -> None:
    with Place(None) as one, Place(None) as other:
        assert one.domain != other.domain
        ports = {port for place in (one, other) for port in (place.master_port, place.router_port, place.yarp_port)}
        assert len(ports) == 6
        assert one.config.ros1.master == one.master
        assert one.config.hub.listen.endswith(f":{one.router_port}")
        folders = (one.folder, other.folder)
    assert not any(folder.exists() for folder in folders)


def test_place_keeps_the_rules_of_its_template(tmp_path: Path) -> None:
    template = tmp_path / "rules.yaml"
    template.write_text(
        "name: mine\nhub: {listen: tcp/127.0.0.1:7447}\nrouting:\n  rules:\n    - {topic: /a, deny: true}\n"
    )
    with Place(template) as place:
        assert place.config.routing.rules[0].deny
        assert place.config.name != "mine"
        assert not place.config.hub.listen.endswith(":7447")


def test_the_shipped_configuration_is_sound() -> None:
    from bridge.demo.place import CONFIG

    with Place(CONFIG) as place:
        assert place.config.routing.rules


def test_shared_memory_of_others_is_left_alone() -> None:
    ports = range(10000, 10250)
    own = [n for n in ("12.zenoh", "fastrtps_0123456789abcdef", "fastrtps_port10011_el") if traces.is_own(n, ports)]
    assert len(own) == 3
    others = ("lttng-ust-wait-6", "fastrtps_port7000", "sem.fastrtps_port9999_mutex", "psm_1234", "zenoh")
    assert not any(traces.is_own(name, ports) for name in others)


def test_what_is_missing_is_told_with_its_cure(tmp_path: Path) -> None:
    from bridge.config.model import Config

    config = Config.model_validate({"ros1": {"packages": str(tmp_path)}})
    told = requirements.missing(config)
    assert told
    assert str(tmp_path) in told[0]


def test_ports_of_a_place_are_none_that_connections_going_out_take() -> None:
    with Place(None) as first, socket.socket() as taken:
        low, domain = first.master_port, first.domain
        taken.bind(("127.0.0.1", first.router_port))
        free = place._free_ports(3, domain)
        assert first.router_port not in free
        assert max(*free, first.yarp_port) < 32_768  # net.ipv4.ip_local_port_range, as Linux has it
        assert low == free[0]


def test_a_program_that_waits_for_ever_ends_with_its_input() -> None:
    """As rospy does, whose master died while it registered with it."""
    waits = "from bridge.demo import report; report.LAST_SECONDS = 1; report.Voice(); import time; time.sleep(600)"
    with subprocess.Popen([sys.executable, "-c", waits], stdin=subprocess.PIPE, cwd=ROOT) as program:
        assert program.stdin is not None
        program.stdin.close()
        assert program.wait(30) == -signal.SIGALRM


LEAVES_ONE_BEHIND = """
import subprocess, sys, time
sleep = [sys.executable, "-c", "import time; time.sleep(600)"]
print(subprocess.Popen(sleep, start_new_session=True, stdout=subprocess.DEVNULL).pid, flush=True)
time.sleep(600)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="orphans are found on Linux")
def test_a_guard_leaves_nothing_behind_that_its_command_left() -> None:
    """As a daemon leaves its router that had to be killed, and a roscore its master."""
    command = [str(part) for part in guarded(sys.executable, "-c", LEAVES_ONE_BEHIND)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as guard:
        assert guard.stdin is not None
        assert guard.stdout is not None
        left = int(guard.stdout.readline())
        assert psutil.pid_exists(left)
        guard.stdin.close()
        guard.wait(30)
    assert not psutil.pid_exists(left)
