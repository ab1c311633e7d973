"""`/diagnostics` shows the state of each part to programs of ROS 1, ROS 2 and YARP, and at once after a change."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.config.load import load
from bridge.config.model import Config
from bridge.daemon.query import Phase, ask_daemon
from bridge.hub.diagnostics import DIAGNOSTICS_WANTED, TOPIC, TYPE, has_subscribers
from bridge.hub.graph.tokens import Origin
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.metrics import diagnostics, on_demand
from bridge.metrics.diagnostics import publishing_worker
from bridge.metrics.on_demand import DiagnosticsOnDemand
from bridge.metrics.parts import Level, PartStatus, parts
from bridge.metrics.section import MetricsSection
from bridge.metrics.source import enabled_workers
from bridge.status import read_daemon_status
from bridge.worker import Health, Worker
from tests.adapters.yarp.conftest import YarpPort
from tests.contract.hubside import HubSide
from tests.metrics.documents import route, side, snapshot
from tests.peers.daemon.deployment import Deployment
from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.hub.quick import QuickHub
from tests.peers.yarp.programs import Names
from tests.support.forks import DAEMON_AND_WORKERS
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

ARRAY = "diagnostic_msgs/DiagnosticArray"


def worker_document(worker: str, phase: str = "running", beat: float | None = 0.2, text: str = "") -> dict[str, Any]:
    return {"worker": worker, "phase": phase, "pid": 7, "restarts": 1, "beat": beat, "text": text}


def statuses(*documents: dict[str, Any], **daemon: Any) -> dict[str, PartStatus]:
    config = Config.model_validate({"name": "here", "navigation": {"planner": "nav2"}})
    return {status.part: status for status in parts(snapshot(*documents, **daemon), config)}


@pytest.mark.parametrize(
    ("phase", "beat", "level"),
    [("running", 0.2, Level.OK), ("running", 4.0, Level.STALE), ("starting", None, Level.WARN),
     ("restarting", None, Level.ERROR), ("cannot work", None, Level.ERROR), ("stopping", 0.2, Level.WARN)],
)  # fmt: skip
def test_a_workers_level_follows_its_phase_and_heartbeat(phase: str, beat: float | None, level: Level) -> None:
    status = statuses(pid=1, workers=[worker_document("ros1", phase, beat, "why")])["worker ros1"]
    assert status.level == level
    assert status.values["restarts"] == 1
    assert ("why" in status.message) == (level is not Level.STALE)


def test_disabled_workers_are_not_listed() -> None:
    assert "worker sim" not in statuses(
        pid=1, workers=[worker_document("sim", "off"), worker_document("zenoh", "not available")]
    )


@pytest.mark.parametrize(("state", "level"), [("running", 0), ("standby", 0), ("waiting", 1), ("odd", 2)])
def test_a_sides_level_follows_its_state(state: str, level: int) -> None:
    sides = statuses(side(route(), state=state, network="n1"), pid=1, workers=[worker_document("ros1")])
    status = sides["side ros1"]
    assert status.level == level
    assert (status.values["routes"], status.values["dropped"]) == (1, 1)


def test_a_side_without_a_running_worker_is_stale() -> None:
    named = statuses(
        pid=1,
        workers=[
            worker_document("ros1", "restarting", None),
            worker_document("router"),
            worker_document("modules", "restarting", None),
        ],
    )
    assert named["side ros1"].level is Level.STALE
    assert "side router" not in named
    assert named["module gateway"].level is Level.STALE


def test_modules_and_boards_that_wait_or_are_missing_raise_the_level() -> None:
    boards = [{"board": "/r/base", "trouble": "not reached yet"}, {"board": "/r/arm", "trouble": "", "joints": ["a"]}]
    head = {"module": True, "routes": []}
    named = statuses(
        {"worker": "control_boards", "state": "waiting", "text": "no board", "boards": boards, **head},
        {"worker": "store", "state": "running", **head},
        pid=1, workers=[worker_document("modules")],
    )  # fmt: skip
    levels = {name: status.level.name for name, status in named.items()}
    assert levels == {
        "daemon": "OK", "worker modules": "OK", "module control_boards": "WARN", "module store": "OK",
        "board /r/base": "WARN", "board /r/arm": "OK", "module gateway": "ERROR",
    }  # fmt: skip
    assert named["module gateway"].message == "not running"


def test_the_daemons_level_shows_that_it_is_down_or_refused_a_reload() -> None:
    assert statuses()["daemon"].level is Level.STALE
    assert statuses(pid=1, refused="line 3")["daemon"].level is Level.WARN


@pytest.mark.parametrize(
    ("phases", "turn"),
    [
        ({"router": "running", "ros1": "running", "web": "running", "metrics": "running"}, "metrics"),
        ({"ros1": "running", "web": "running", "metrics": "restarting"}, "web"),
        ({"ros1": "starting", "ros2": "running", "modules": "running", "web": "off"}, "ros2"),
        ({"modules": "running", "ros1": "off"}, "modules"),
        ({"router": "running"}, ""),
    ],
)
def test_the_first_running_worker_of_a_fixed_order_publishes(phases: dict[str, str], turn: str) -> None:
    daemon = {"workers": [worker_document(name, phase) for name, phase in phases.items()]}
    assert publishing_worker(read_daemon_status(daemon)) == turn


class Side(Worker):
    """A worker with a side's node on the hub."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub

    def diagnostics_wanted(self) -> bool:
        return has_subscribers(self._hub.graph)

    def start(self, config: Config) -> None:
        """Do nothing."""

    def reload(self, config: Config) -> bool:  # noqa: ARG002
        return True

    def health(self) -> Health:
        return Health("running", "")

    def stop(self) -> None:
        """Do nothing."""


class Wanting(Side):
    """A side that always has a subscriber."""

    def __init__(self) -> None:
        """Have no node."""

    def diagnostics_wanted(self) -> bool:
        return True


class PublishingSide:
    """The worker ``ros1`` on a hub; the test sets the status document of its daemon."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.hubs = QuickHub()
        self.hub = Hub.open(self.hubs.settings("ros1", "ros1", "here"))
        self.hub.set_origin(Origin("ros1", "n1", "here"))
        self.asked = 0
        self.hub.serve("status", self.status)
        self.far = HubSide(Hub.open(self.hubs.settings("far")), Registry())
        self.daemon_document: dict[str, Any] = {"pid": 1, "workers": [worker_document("ros1")]}
        monkeypatch.setattr(diagnostics, "ask_daemon", lambda *_: read_daemon_status(self.daemon_document))
        self.config = Config.model_validate(
            {"name": "here", "state": folder, "hub": {"listen": self.hubs.endpoint, "domain": self.hubs.domain}}
        )
        self.publishing = DiagnosticsOnDemand(Side(self.hub), "ros1")

    def status(self, _params: dict[str, Any]) -> dict[str, Any]:
        self.asked += 1
        return side(state="running", network="n1")

    def is_announced(self) -> bool:
        """Poll as a heartbeat does, and return whether the topic is on the hub."""
        self.publishing.on_heartbeat(self.config)
        return bool(self.far.hub.graph.publishers(TOPIC))

    def close(self) -> None:
        self.publishing.close()
        self.hub.close()
        self.far.hub.close()
        self.hubs.stop_router()


@pytest.fixture
def publishing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[PublishingSide]:
    side_ = PublishingSide(tmp_path, monkeypatch)
    yield side_
    side_.close()


def test_a_publisher_that_is_slow_to_end_does_not_continue_beside_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    closings, end = list[threading.Event](), threading.Event()

    def publish_slowly(_wanted: object, closing: threading.Event, _config: Config, _worker: str) -> None:
        closings.append(closing)
        end.wait(20)

    monkeypatch.setattr(diagnostics, "publish_while", publish_slowly)
    monkeypatch.setattr(on_demand, "_END_SECONDS", 0.0, raising=False)
    publishing = DiagnosticsOnDemand(Wanting(), "ros1")
    for number in (1, 2):
        publishing.on_heartbeat(Config(name=f"robot{number}"))
        until(lambda count=number: len(closings) == count, "the publisher starts")
    assert [closing.is_set() for closing in closings] == [True, False]
    end.set()
    publishing.close()


def test_publishes_only_with_subscribers_and_at_once_on_a_change(
    publishing: PublishingSide, monkeypatch: pytest.MonkeyPatch
) -> None:
    until(lambda: any(node.node == "far" for node in publishing.hub.graph.nodes()), "the other node is discovered")
    before = set(threading.enumerate())
    assert not publishing.is_announced()
    # zenoh's threads appear when they first call Python
    started = [t for t in threading.enumerate() if t not in before and not isinstance(t, threading._DummyThread)]
    assert (publishing.asked, started) == (0, [])
    subscription = publishing.far.subscribe(TOPIC, ARRAY)
    until(publishing.is_announced, "the topic is on the hub", 10)
    first = until(lambda: publishing.far.wait(subscription, 1, 0.2), "diagnostics are published", 10)[0]
    named = {status["name"]: status for status in first["status"]}
    assert named["midspan here: side ros1"]["hardware_id"] == "here"
    assert {pair["key"]: pair["value"] for pair in named["midspan here: worker ros1"]["values"]}["restarts"] == "1"
    assert first["header"]["stamp"]["sec"] > 1e9
    count = len(publishing.far.wait(subscription, 1, 0.0))
    monkeypatch.setattr(diagnostics, "PERIOD", 3600.0)
    assert len(publishing.far.wait(subscription, count + 1, 40.0)) > count, "the message that was already due arrives"
    publishing.daemon_document = {
        "pid": 1,
        "workers": [worker_document("ros1"), worker_document("ros2", "restarting", None, "signal 9")],
    }

    def is_reported() -> bool:
        """Return whether the newest message has the change; one of before may still be on its way."""
        last = publishing.far.wait(subscription, 1, 0.0)[-1]
        return {s["name"]: s["level"] for s in last["status"]}.get("midspan here: worker ros2") == Level.ERROR

    until(is_reported, "the change is published before the period is over")


def test_publishes_for_a_sides_subscriber_and_yields_to_the_metrics_worker(publishing: PublishingSide) -> None:
    kind = Registry().ros2(TYPE).type_id
    wanted = publishing.far.hub.subscription(DIAGNOSTICS_WANTED, TYPE, kind, Qos(), lambda _sample: None)
    until(lambda: publishing.is_announced() and publishing.asked > 1, "the worker publishes periodically", 10)
    publishing.daemon_document = {"pid": 1, "workers": [worker_document("ros1"), worker_document("metrics")]}
    until(lambda: not publishing.is_announced(), "the metrics worker publishes", 10)
    publishing.daemon_document = {
        "pid": 1,
        "workers": [worker_document("ros1"), worker_document("metrics", "restarting")],
    }
    until(publishing.is_announced, "the metrics worker has ended", 10)
    wanted.close()
    until(lambda: not publishing.is_announced(), "the last subscriber has left", 10)


def test_diagnostics_can_be_disabled(publishing: PublishingSide) -> None:
    publishing.far.subscribe(TOPIC, ARRAY)
    until(publishing.is_announced, "the topic is on the hub", 10)
    publishing.config = publishing.config.model_copy(update={"metrics": MetricsSection(diagnostics=False)})
    until(lambda: not publishing.is_announced(), "nothing is published", 10)


def test_ros_subscribers_receive_all_parts_without_console_and_metrics(tmp_path: Path) -> None:
    with Deployment(tmp_path) as deployment:
        deployment.start(navigation={"planner": "nav2"}, store={"enabled": True}, yarp={"enabled": False})
        subscribers = [(program, program.subscribe(TOPIC, ARRAY)) for program in (deployment.ros1(), deployment.ros2())]
        native = deployment.zenoh()
        at_hub = native.subscribe(TOPIC, ARRAY)

        def levels(program: Any, subscription: int) -> dict[str, int]:
            """Return the levels in the last message about parts; messages of a side's routes do not count."""
            statuses = [
                m["status"] for m in program.wait(subscription, 1, 1.0) if m["status"][0]["hardware_id"] == "interop"
            ]
            return {s["name"].removeprefix("midspan interop: "): s["level"] for s in (statuses or [[]])[-1]}

        parts = {f"worker {name}" for name in ("router", "ros1", "ros2", "modules")}
        parts |= {"daemon", "side ros1", "side ros2", "module gateway", "module store"}
        # the modules' worker may start after the sides, and its modules are listed from the beginning
        final = {"side ros1": 0, "worker ros2": 0, "module store": 0, "module gateway": 1}  # it waits for its planner
        for program, subscription in (*subscribers, (native, at_hub)):
            until(
                lambda p=program, h=subscription: (
                    parts <= (now := levels(p, h)).keys() and final.items() <= now.items()
                ),
                "the message has all parts with their levels",
                30,
            )
        assert publishing_worker(ask_daemon(load(deployment.file), 20.0)) == "ros1"
        program, subscription = subscribers[1]

        def is_reported_down() -> bool:
            """Kill the worker if it runs, and return whether the other side reports it as down; it restarts quickly."""
            for report in enabled_workers(ask_daemon(load(deployment.file))):
                if report.worker == "ros1" and report.phase == Phase.UP.value:
                    with suppress(ProcessLookupError):
                        os.kill(report.pid, signal.SIGKILL)
            return levels(program, subscription).get("worker ros1", 0) != 0

        until(is_reported_down, "the other side reports the restart", 20, every=0.05)
        for program, subscription in subscribers:
            program.wait(subscription, 10_000, 0.1)
            until(lambda p=program, h=subscription: levels(p, h).get("worker ros1") == 0, "the worker runs again", 40)


def test_a_yarp_reader_receives_all_parts(tmp_path: Path) -> None:
    names, number = Names(), free_port()
    off = {"enabled": False}
    sections = {
        "hub": {"listen": f"tcp/127.0.0.1:{number}"}, "ros1": off, "ros2": off,
        "yarp": {"nameserver": "site", "address": names.endpoint, "poll": 0.1},
    }  # fmt: skip
    file = tmp_path / "midspan.yaml"
    file.write_text(yaml.safe_dump({"name": "here", "state": str(tmp_path / "state"), **sections}))
    with ExitStack() as stack:
        stack.callback(names.stop)
        stack.enter_context(Process([*MIDSPAN, "run", "--config", file], imports=DAEMON_AND_WORKERS))
        reader = YarpPort(names, "/reader")
        stack.callback(reader.stop)
        until(lambda: names.client.query("/midspan/diagnostics:o"), "the port is registered", 40)
        router = f"tcp/127.0.0.1:{number}"
        far = Hub.open(HubSettings(router=router, node="far", daemon="far", worker="far", shared_memory=False))
        stack.callback(far.close)
        until(
            lambda: any(node.node == "midspan_yarp" for node in far.graph.nodes()), "the hub's nodes are discovered", 20
        )
        assert not far.graph.publishers(TOPIC), "diagnostics are not published without a subscriber"
        reader.listen_to("/midspan/diagnostics:o")
        parts = ("midspan here: daemon", "midspan here: side yarp", "midspan here/yarp: worker")
        until(lambda: all(f"'{part}'" in str(reader.bottles()) for part in parts), "the message has all parts", 20)
        reader.stop()
        until(lambda: not far.graph.publishers(TOPIC), "publishing ends after the last subscriber has left", 20)
