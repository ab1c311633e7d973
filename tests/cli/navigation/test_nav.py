"""``midspan goto`` and ``midspan nav`` with a gateway whose planner is the test."""

from __future__ import annotations

import base64
import json
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from bridge.cli.client import CliClient
from bridge.cli.navigation.gateway import gateway_status, no_answer
from bridge.cli.navigation.goto import GoalProgress
from bridge.client.navigation import STATUS, STATUS_TOPIC, state_text
from bridge.client.session import connect
from bridge.config.model import Config
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.velocities import TWIST
from bridge.status import read_daemon_status
from bridge.stores.kinds import AREA, LOCATION, MAP
from navigation.nav2_errors import reason_text
from navigation.status import State
from tests.cli.conftest import Midspan, Outcome, alongside
from tests.peers.daemon.workers import FakeWorker, config_file
from tests.peers.hub.network import HubNetwork
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import ClientGoal, Planner, Rig, pose
from tests.support.wait import until
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.vec2d import Vec2D

KEPT = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    with Rig(tmp_path_factory.mktemp("nav")) as rig:
        store = rig.worker.store
        store.put(MAP, "flat", MapGrid2D.of(np.zeros((80, 100), np.uint8), name="flat", resolution=0.1))
        store.use_map("flat")
        store.put(LOCATION, "kitchen", Map2DLocation("flat", 2.5, 1.0, 90.0, ""))
        corners = [Vec2D(4.0, 4.0), Vec2D(6.0, 4.0), Vec2D(6.0, 6.0), Vec2D(4.0, 6.0)]
        store.put(AREA, "the hall", Map2DArea("flat", corners, ""))
        yield rig


@pytest.fixture
def rig(running: Rig) -> Rig:
    running.fresh()
    return running


@pytest.fixture
def midspan(rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Midspan:
    file = tmp_path / "midspan.yaml"
    file.write_text(json.dumps({"name": "here", "hub": {"listen": rig.hubs.endpoint}, "navigation": rig.section}))
    return Midspan(file, capsys)


def run_with_script(midspan: Midspan, words: list[str], script: Callable[[], None]) -> Outcome:
    """Run ``goto`` while a function acts as the planner."""
    with alongside(script):
        return midspan("goto", "--timeout", "40", *words)


def position_of(goal: Any) -> tuple[float, float, float]:
    place = goal.goal["pose"]["pose"]
    turn = place["orientation"]
    theta = math.degrees(2.0 * math.atan2(turn["z"], turn["w"]))
    return place["position"]["x"], place["position"]["y"], pytest.approx(theta, abs=1e-6)


def test_progress_prints_each_change_with_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    mine, other = (base64.b64encode(bytes([number] * 16)).decode() for number in (1, 2))
    progress = GoalProgress(bytes([1] * 16), as_json=False)
    progress.refresh()
    for goal, state, reason in (
        (mine, "moving", ""),
        (other, "aborted", "not ours"),
        (mine, "waiting_obstacle", "a chair is ahead"),
        (mine, "waiting_obstacle", "a chair is ahead"),
        (mine, "moving", ""),
    ):
        progress.update({"goal_id": goal, "state": state, "reason": reason})
    progress.feedback({"distance_remaining": 3.25})
    progress.refresh()
    progress.refresh()
    expected = ["moving, 3.2 m to go", "waiting obstacle: a chair is ahead, 3.2 m to go", "moving, 3.2 m to go"]
    assert capsys.readouterr().out.splitlines() == expected


@pytest.mark.parametrize(
    "feedback",
    [
        pytest.param({"distance_remaining": 0.0}, id="nav2-before-its-path"),
        pytest.param({"distance_remaining": math.nan}, id="move_base-without-a-pose"),
        pytest.param({"distance_remaining": None}, id="none"),
        pytest.param({"distance_remaining": -1.0}, id="negative"),
        pytest.param({}, id="absent"),
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_no_distance_is_printed_before_it_is_known(
    capsys: pytest.CaptureFixture[str], feedback: dict[str, Any], *, as_json: bool
) -> None:
    progress = GoalProgress(bytes([1] * 16), as_json=as_json)
    goal = base64.b64encode(bytes([1] * 16)).decode()

    def printed(state: str, **distance: Any) -> str:
        progress.feedback(distance)
        progress.update({"goal_id": goal, "state": state, "reason": ""})
        progress.refresh()
        return capsys.readouterr().out

    unknown = '{"state": "moving", "reason": "", "distance": null}' if as_json else "moving"
    known = '{"state": "thinking", "reason": "", "distance": 3.25}' if as_json else "thinking, 3.2 m to go"
    assert printed("moving", **feedback) == f"{unknown}\n"
    assert printed("thinking", distance_remaining=3.25) == f"{known}\n"
    assert printed("moving", **feedback) == f"{unknown}\n"  # from a planner that was replaced


@pytest.mark.parametrize(
    ("code", "message", "text"),
    [
        (208, "", "no path to the goal (Nav2 208)"),
        (204, "nav2 gave it up", "the goal is outside the map (Nav2 204): nav2 gave it up"),
        (208, "no path to the goal", "no path to the goal (Nav2 208)"),
        (208, "no path to the goal (Nav2 208)", "no path to the goal (Nav2 208)"),
        (20006, "no way leads there", "no way leads there"),
        (0, "", ""),
        (77, "", ""),
    ],
)
def test_nav2_error_codes_are_explained(code: int, message: str, text: str) -> None:
    assert reason_text(message, code) == text
    status = {"state": "aborted", "reason": message, "error_code": code}
    assert state_text(status) == (f"aborted: {text}" if text else "aborted")


def test_the_error_code_of_a_nav2_goal_is_explained_at_its_end(rig: Rig, midspan: Midspan) -> None:
    outcome = run_with_script(midspan, ["1", "2", "0"], lambda: rig.planner.give_up(rig.planner.until(1), "", 208))
    assert outcome.code == 1
    assert "midspan: aborted: no path to the goal (Nav2 208)" in outcome.err
    outcome = run_with_script(
        midspan, ["--json", "1", "2", "0"], lambda: rig.planner.give_up(rig.planner.until(2), "", 203)
    )
    assert outcome.lines()[-1]["code"] == 203
    assert outcome.lines()[-1]["reason"].startswith("the robot is outside the map (Nav2 203)")


def test_goto_drives_to_a_place_and_prints_the_progress(rig: Rig, midspan: Midspan) -> None:
    def drive() -> None:
        goal = rig.planner.until(1)
        assert position_of(goal) == (2.5, 1.0, 90.0)
        rig.planner.publish_status(goal, State.WAITING, "a chair is ahead")
        rig.state(State.WAITING)
        rig.planner.reach(goal)

    outcome = run_with_script(midspan, ["kitchen"], drive)
    assert outcome.code == 0, outcome
    lines = outcome.out.splitlines()
    assert (lines[0], lines[-1]) == ("to 2.50, 1.00 m, 90 degrees in map", "arrived")


def test_goto_reports_why_a_goal_was_aborted(rig: Rig, midspan: Midspan) -> None:
    def refuse() -> None:
        goal = rig.planner.until(1)
        assert position_of(goal) == (-1.5, 2.0, -90.0)
        rig.planner.give_up(goal, "no way leads there")

    outcome = run_with_script(midspan, ["--json", "-1.5", "2.0", "-90"], refuse)
    assert outcome.code == 1
    assert outcome.lines()[-1] == {"status": "aborted", "reason": "no way leads there", "code": 20006}


def test_goto_drives_to_several_places_in_order(rig: Rig, midspan: Midspan) -> None:
    def reach_both() -> None:
        for number, x in ((1, 5.0), (2, 2.5)):
            goal = rig.planner.until(number)
            assert position_of(goal)[0] == x
            rig.planner.reach(goal)

    outcome = run_with_script(midspan, ["the hall", "kitchen"], reach_both)
    assert (outcome.code, outcome.out.splitlines()[-1]) == (0, "arrived")
    assert "; 2.50, 1.00 m, 90 degrees in map" in outcome.out.splitlines()[0]


def test_a_goal_without_heading_is_reached_in_any_heading(rig: Rig, midspan: Midspan) -> None:
    def reach_goal() -> None:
        goal = rig.planner.until(1)
        assert "heading" in goal.goal["behavior_tree"]
        rig.planner.reach(goal)

    outcome = run_with_script(midspan, ["1", "2"], reach_goal)
    assert (outcome.code, outcome.out.splitlines()[0]) == (0, "to 1.00, 2.00 m in map, in any heading")


def test_ctrl_c_and_timeout_cancel_the_goal(rig: Rig, midspan: Midspan) -> None:
    def interrupt() -> None:
        rig.planner.until(1)
        os.kill(os.getpid(), signal.SIGINT)

    outcome = run_with_script(midspan, ["the hall"], interrupt)
    assert outcome.code == 130
    assert "Ctrl-C: the goal is being canceled" in outcome.err
    outcome = run_with_script(midspan, ["--timeout", "0.5", "kitchen"], lambda: None)
    assert outcome.code == 1
    assert "0.5 s have passed" in outcome.err
    until(lambda: not rig.gateway.driving, "nothing drives")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_cancels_the_goal(rig: Rig, midspan: Midspan, number: signal.Signals, code: int) -> None:
    """The process reports in one line that the goal was canceled, and the status does not report a lost client."""
    rig.statuses.clear()
    goto = process(midspan, "kitchen")
    goal = rig.planner.until(1)
    rig.state(State.MOVING)
    goto.send_signal(number)
    out, err = goto.communicate(timeout=40)
    assert (goto.returncode, err) == (code, f"midspan: {number.name}: the goal was canceled\n")
    assert out.splitlines()[0] == "to 2.50, 1.00 m, 90 degrees in map"
    assert not goal.active
    until(lambda: not rig.gateway.driving, "nothing drives")
    assert not [status for status in rig.statuses if "machine" in status["reason"]]


def test_a_closed_output_cancels_the_goal(rig: Rig, midspan: Midspan) -> None:
    """This happens in ``midspan goto kitchen | head -1``."""
    goto = process(midspan, "kitchen")
    assert goto.stdout is not None
    goal = rig.planner.until(1)
    goto.stdout.close()
    rig.planner.publish_status(goal, State.WAITING, "a chair is ahead")
    assert goto.wait(20) == 0
    assert goto.stderr is not None
    assert goto.stderr.read() == "midspan: the output was closed: the goal was canceled\n"
    goto.stderr.close()
    until(lambda: not rig.gateway.driving, "nothing drives")


def test_killed_client_is_not_reported_as_remote(rig: Rig, midspan: Midspan) -> None:
    goto = process(midspan, "kitchen")
    rig.planner.until(1)
    rig.state(State.MOVING)
    goto.kill()
    goto.communicate(timeout=20)
    reason = rig.state(State.ABORTED)["reason"]
    assert "the goal's client is unreachable: the program has exited" in reason


def process(midspan: Midspan, *words: str) -> subprocess.Popen[str]:
    """Start ``midspan goto`` as a process."""
    command = [sys.executable, "-m", "bridge.cli.main", "goto", *words, "--config", str(midspan.config)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize(
    ("words", "why"),
    [(["moon"], "unknown location or area 'moon'"), (["1", "north"], "X Y [DEGREES]"), (["1", "nan"], "X Y [DEGREES]")],
)
def test_invalid_destinations_are_reported(midspan: Midspan, words: list[str], why: str) -> None:
    outcome = midspan("goto", *words)
    assert outcome.code == 1
    assert why in outcome.err


def test_status_pause_resume_and_stop(rig: Rig, midspan: Midspan) -> None:
    assert "no goal to pause" in midspan("nav", "pause").err
    assert midspan("nav", "resume").code == 1
    assert midspan("nav", "status", "--json").json()["planner"] == "robot_goto"
    rig.ask("go_to", name="kitchen")
    rig.planner.until(1)
    rig.state(State.MOVING)
    outcome = midspan("nav", "status")
    assert outcome.out.startswith("moving"), outcome
    assert "goal     2.50, 1.00 m, 90 degrees in map" in outcome.out
    assert "planner  robot_goto" in outcome.out
    assert midspan("nav", "pause").out == "paused\n"
    rig.state(State.PAUSED)
    assert midspan("nav", "status", "--json").json()["state"] == "paused"
    assert midspan("nav", "resume").out == "resumed\n"
    rig.planner.until(2)
    assert midspan("nav", "stop").code == 0
    until(lambda: not rig.gateway.driving, "nothing drives")


def test_status_reports_a_missing_planner(rig: Rig, midspan: Midspan) -> None:
    assert "waits" not in midspan("nav", "status").out
    assert rig.ask("choose_planner", name="robot_path_planner")["success"]
    try:
        status = midspan("nav", "status")
        assert (
            "planner  robot_path_planner\n         the planner robot_path_planner is not available: its module"
            in status.out
        )
        assert "cure: modules.robot_path_planner.enabled: true" in status.out
        assert "its module does not run" in midspan("nav", "status", "--json").json()["waits"]
    finally:
        rig.ask("choose_planner", name="robot_goto")
        # the gateway looks for it at its next poll; without it, the next test's stop would end that test's goals
        until(lambda: rig.gateway.link.reachable, "the gateway finds the planner")
    assert midspan("nav", "status", "--json").json()["waits"] == ""


def test_path_is_printed_and_drawn(rig: Rig, midspan: Midspan, tmp_path: Path) -> None:
    node = rig.planner.node
    out = node.publisher("/planner/robot_goto/path", "nav_msgs/msg/Path", KEPT, priority="state")
    frames = node.publisher("/tf", "tf2_msgs/msg/TFMessage", Qos())
    stop = threading.Event()

    def stand() -> None:
        transform = {"translation": {"x": 1.0, "y": 1.0}, "rotation": {"w": 1.0}}
        while not stop.wait(0.05):
            header = {"stamp": node.clock.stamp(), "frame_id": "map"}
            frames.publish({"transforms": [{"header": header, "child_frame_id": "base_link", "transform": transform}]})

    standing = threading.Thread(target=stand)
    standing.start()
    try:
        rig.ask("go_to", name="kitchen")
        goal = rig.planner.until(1)
        rig.state(State.MOVING)
        out.publish({"header": {"frame_id": "map"}, "poses": [pose(2.5, 4.0), pose(2.5, 1.0, math.pi / 2)]})
        poses = until(lambda: midspan("nav", "path", "--json").json(), "the path is printed")
        assert poses[1] == {"frame": "map", "x": 2.5, "y": 1.0, "theta_deg": pytest.approx(90.0)}
        assert midspan("nav", "path").out.splitlines()[0].split()[:3] == ["1", "2.50", "4.00"]
        shown = midspan("nav", "show", "--width", "100").out
        assert {"o", "a", "b"} <= set(shown)
        assert "goal: 2.5, 1 m, 90 degrees" in shown
        assert "robot: 1, 1 m, 0 degrees" in shown
        picture = tmp_path / "way.png"
        assert midspan("nav", "show", "--png", str(picture)).code == 0
        with Image.open(picture) as image:
            pixels = set(map(tuple, np.asarray(image.convert("RGB")).reshape(-1, 3).tolist()))
        assert {(200, 0, 120), (0, 110, 0)} <= pixels
        rig.planner.reach(goal)
    finally:
        stop.set()
        standing.join()
        node.release(out)
        node.release(frames)


def test_a_missing_gateway_is_reported_with_its_cure(
    network: HubNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.client.services.WAIT_SECONDS", 0.2)
    file = tmp_path / "other.yaml"
    file.write_text(json.dumps({"name": "there", "hub": network.config()}))
    outcome = Midspan(file, capsys)("nav", "stop")
    assert outcome.code == 1
    assert "no gateway is configured: name a planner" in outcome.err


@pytest.mark.parametrize(
    ("phase", "words"),
    [
        ("running", "the gateway's worker runs, but the gateway does not answer: the machine is busy"),
        ("starting", "the gateway does not run: the worker 'modules' of robot1 is starting: importing numpy"),
        ("restarting", "is restarting: importing numpy (restarted 4 times; last end: killed by SIGSEGV)"),
        ("cannot work", "the worker 'modules' of robot1 cannot work: importing numpy"),
        ("off", "the daemon robot1 runs without the worker 'modules': it has not loaded this configuration"),
        ("hangs", "the worker 'modules' of robot1 hangs: its last heartbeat was 4 s ago"),
        ("", "no gateway runs on this hub: no daemon robot1 runs on this machine; on the hub: none"),
    ],
)
def test_daemon_status_separates_a_late_gateway_from_a_missing_one(
    network: HubNetwork,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    phase: str,
    words: str,
) -> None:
    worker = {"worker": "modules", "phase": phase, "text": "importing numpy", "restarts": 0, "beat": 0.5}
    if phase == "restarting":
        worker |= {"restarts": 4, "ended": "killed by SIGSEGV"}
    if phase == "hangs":
        worker |= {"phase": "running", "beat": 4.2}
    document = {"daemon": "robot1", "config": "a.yaml", "workers": [worker]}
    report = read_daemon_status(document) if phase else None
    monkeypatch.setattr("bridge.doctor.daemon_state.ask_daemon", lambda _config: report)
    monkeypatch.setattr("bridge.client.navigation.PATIENCE", 0.1)
    file = config_file(tmp_path, network, navigation={"planner": "robot_goto"}, state=str(tmp_path))
    outcome = Midspan(file, capsys)("nav", "status")
    assert (outcome.code, words in outcome.err) == (1, True), outcome
    other = Midspan(file, capsys)("nav", "status", "--router", network.endpoint)
    assert "modules" not in other.err, "the daemon of this machine is not asked about another hub"


def test_a_slow_gateway_is_not_reported_as_missing(network: HubNetwork, tmp_path: Path, closing: list[Any]) -> None:
    late = threading.Event()
    with connect(Config.model_validate({"hub": network.config(), "state": str(tmp_path)})) as session:
        client = CliClient(session.hub, session.config, session.where)
        assert no_answer(client).startswith("no gateway is configured")
        worker = FakeWorker(network, "gateway", status=lambda _params: {"late": not late.wait(2.5)})
        closing.append(worker)
        # the reply takes 2.5 s: on a busy machine, the 2 s of other queries (`ASK_SECONDS`) would be too short
        assert gateway_status(client).document()["late"]
        worker.publish(STATUS_TOPIC, STATUS, f"RIHS01_{'1' * 64}", b"")
        until(
            lambda: no_answer(client).startswith("the gateway's worker runs"),
            "the gateway's worker is visible on the hub",
        )


def test_stop_reaches_the_planner_without_a_gateway(network: HubNetwork, tmp_path: Path, capsys: Any) -> None:
    """There is no gateway after its worker was killed, until the worker is restarted."""
    file = tmp_path / "midspan.yaml"
    file.write_text(json.dumps({"hub": network.config(), "navigation": {"planner": "move_base"}}))
    midspan = Midspan(file, capsys)
    with Hub.open(network.settings("base")) as base:
        received: list[HubSample] = []
        base.subscription("/cmd_vel", TWIST, "*", Qos(), received.append)
        base.graph.announce_velocity("/far/cmd_vel", TWIST)
        outcome = midspan("nav", "stop")
        assert outcome.code == 1
        assert "Nor is the planner move_base on the hub: the robot may still be moving" in outcome.err
        assert "/far/cmd_vel: nodes of a side subscribe" in outcome.err
        until(lambda: received, "the base gets a zero velocity nevertheless")
    planner, client = Planner(network.settings("planner"), "move_base"), HubNode(network.settings("client"))
    try:
        client_goal = ClientGoal(client, pose(5.0), "/planner/move_base/navigate_to_pose")
        goal = planner.until(1)
        outcome = midspan("nav", "stop")
        assert (outcome.code, outcome.err) == (0, "")
        assert "the gateway is not running; move_base itself was asked: 1 goal canceled" in outcome.out
        assert client_goal.end()[0] == "CANCELED"
        assert not goal.active
    finally:
        for program in (planner, client):
            program.close()
