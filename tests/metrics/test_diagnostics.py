"""`/diagnostics` tells how each part is: to real programs of both ROS sides, and at once when a part changes."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.clock import SYSTEM
from bridge.config.load import load
from bridge.config.model import Config
from bridge.daemon.query import ask_daemon
from bridge.hub.control import WorkerAnswer
from bridge.hub.diagnostics import HEARD, TOPIC, TYPE
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.metrics import diagnostics
from bridge.metrics.diagnostics import DiagnosticsTeller
from bridge.metrics.parts import Level, PartStatus, parts
from bridge.metrics.source import Source
from tests.contract.hubside import HubSide
from tests.interop.deployment import Deployment
from tests.metrics.documents import route, side, snapshot
from tests.support.quick_hub import QuickHub
from tests.support.wait import until

ARRAY = "diagnostic_msgs/DiagnosticArray"


def word(worker: str, phase: str = "running", beat: float | None = 0.2, text: str = "") -> dict[str, Any]:
    return {"worker": worker, "phase": phase, "pid": 7, "restarts": 1, "beat": beat, "text": text}


def told(*documents: dict[str, Any], **daemon: Any) -> dict[str, PartStatus]:
    config = Config.model_validate({"name": "here", "navigation": {"planner": "nav2"}})
    return {status.part: status for status in parts(snapshot(*documents, **daemon), config)}


@pytest.mark.parametrize(
    ("phase", "beat", "level"),
    [("running", 0.2, Level.OK), ("running", 4.0, Level.STALE), ("starting", None, Level.WARN),
     ("restarting", None, Level.ERROR), ("cannot work", None, Level.ERROR), ("stopping", 0.2, Level.WARN)],
)  # fmt: skip
def test_a_worker(phase: str, beat: float | None, level: Level) -> None:
    status = told(pid=1, workers=[word("ros1", phase, beat, "why")])["worker ros1"]
    assert status.level == level
    assert status.values["restarts"] == 1
    assert ("why" in status.message) == (level is not Level.STALE)


def test_what_is_switched_off_is_no_part() -> None:
    assert "worker sim" not in told(pid=1, workers=[word("sim", "off"), word("zenoh", "not available")])


@pytest.mark.parametrize(("state", "level"), [("running", 0), ("standby", 0), ("waiting", 1), ("odd", 2)])
def test_a_side(state: str, level: int) -> None:
    found = told(side(route(), state=state, network="n1"), pid=1, workers=[word("ros1")])
    status = found["side ros1"]
    assert status.level == level
    assert (status.values["routes"], status.values["dropped"]) == (1, 1)


def test_a_side_whose_worker_is_gone_is_stale() -> None:
    found = told(pid=1, workers=[word("ros1", "restarting", None), word("router"), word("modules", "restarting", None)])
    assert found["side ros1"].level is Level.STALE
    assert "side router" not in found
    assert found["module gateway"].level is Level.STALE


def test_modules_and_boards() -> None:
    boards = [{"board": "/r/base", "trouble": "not reached yet"}, {"board": "/r/arm", "trouble": "", "joints": ["a"]}]
    head = {"module": True, "routes": []}
    found = told(
        {"worker": "control_boards", "state": "waiting", "text": "no board", "boards": boards, **head},
        {"worker": "store", "state": "running", **head},
        pid=1, workers=[word("modules")],
    )  # fmt: skip
    levels = {name: status.level.name for name, status in found.items()}
    assert levels == {
        "daemon": "OK", "worker modules": "OK", "module control_boards": "WARN", "module store": "OK",
        "board /r/base": "WARN", "board /r/arm": "OK", "module gateway": "ERROR",
    }  # fmt: skip
    assert found["module gateway"].message == "it does not run"


def test_the_daemon() -> None:
    assert told()["daemon"].level is Level.STALE
    assert told(pid=1, refused="line 3")["daemon"].level is Level.WARN


class Told:
    """A teller on a hub, of a daemon whose word the test gives."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.hubs = QuickHub()
        self.hub = Hub.open(self.hubs.settings("teller", "metrics", "here"))
        self.far = HubSide(Hub.open(self.hubs.settings("far")), Registry())
        self.said: dict[str, Any] = {"pid": 1, "workers": [word("ros1")]}
        self.asked = 0
        monkeypatch.setattr(diagnostics, "ask_daemon", lambda *_: self.said)
        config = Config(name="here", state=folder)
        self.teller = DiagnosticsTeller(config, self.hub, Registry(), SYSTEM, Source(config, self.ask))

    def ask(self) -> list[WorkerAnswer]:
        self.asked += 1
        return [WorkerAnswer("here", "ros1", side(state="running", network="n1"))]

    def close(self) -> None:
        self.teller.close()
        self.hub.close()
        self.far.hub.close()
        self.hubs.stop_router()


@pytest.fixture
def teller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Told]:
    made = Told(tmp_path, monkeypatch)
    yield made
    made.close()


def test_nothing_is_asked_while_nobody_hears_and_a_change_is_told_at_once(
    teller: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    until(lambda: any(node.node == "far" for node in teller.hub.graph.nodes()), "the other node is seen")
    assert teller.asked == 0
    heard = teller.far.subscribe(TOPIC, ARRAY)
    first = until(lambda: teller.far.wait(heard, 1, 0.2), "it tells", 10)[0]
    named = {status["name"]: status for status in first["status"]}
    assert named["midspan here: side ros1"]["hardware_id"] == "here"
    assert {pair["key"]: pair["value"] for pair in named["midspan here: worker ros1"]["values"]}["restarts"] == "1"
    assert first["header"]["stamp"]["sec"] > 1e9
    monkeypatch.setattr(diagnostics, "PERIOD", 60.0)
    count = len(teller.far.wait(heard, 1, 0.0))
    assert len(teller.far.wait(heard, count + 1, 10.0)) == count + 1, "what was due already"
    teller.said = {"pid": 1, "workers": [word("ros1", "restarting", None, "signal 9")]}
    last = teller.far.wait(heard, count + 2, 10.0)[-1]
    assert {s["name"]: s["level"] for s in last["status"]}["midspan here: worker ros1"] == Level.ERROR


def test_a_side_that_hears_is_told(teller: Told) -> None:
    kind = Registry().ros2(TYPE).type_id
    asked = teller.far.hub.subscription(HEARD, TYPE, kind, Qos(), lambda _sample: None)
    until(lambda: teller.asked > 1, "it tells again and again", 10)
    asked.close()
    until(lambda: not teller.hub.graph.subscriptions(HEARD), "nobody hears", 10)


def test_real_programs_of_both_sides_hear_of_all_parts(tmp_path: Path) -> None:
    with Deployment(tmp_path) as made:
        made.start(
            metrics={"enabled": True, "listen": "127.0.0.1:0"}, navigation={"planner": "nav2"},
            store={"enabled": True}, yarp={"enabled": False},
        )  # fmt: skip
        hearers = [(program, program.subscribe(TOPIC, ARRAY)) for program in (made.ros1(), made.ros2())]

        def every_level(program: Any, heard: int) -> list[dict[str, int]]:
            """What each message says of the parts; those of a side's routes say nothing of them."""
            return [
                {s["name"].removeprefix("midspan interop: "): s["level"] for s in message["status"]}
                for message in program.wait(heard, 1, 1.0)
                if message["status"][0]["hardware_id"] == "interop"
            ]

        def levels(program: Any, heard: int) -> dict[str, int]:
            return (every_level(program, heard) or [{}])[-1]

        parts = {f"worker {name}" for name in ("router", "ros1", "ros2", "modules", "metrics")}
        parts |= {"daemon", "side ros1", "side ros2", "module gateway", "module store"}
        for program, heard in hearers:
            found = until(lambda p=program, h=heard: parts <= (now := levels(p, h)).keys() and now, "all parts", 30)
            assert {part: found[part] for part in ("side ros1", "worker ros2", "module store")} == {
                "side ros1": 0, "worker ros2": 0, "module store": 0,
            }  # fmt: skip
            assert found["module gateway"] == 1, "it waits for its planner"
        said = ask_daemon(load(made.file))
        assert said is not None
        os.kill(next(one["pid"] for one in said["workers"] if one["worker"] == "modules"), signal.SIGKILL)
        program, heard = hearers[0]
        until(
            lambda: any(each["worker modules"] == Level.ERROR for each in every_level(program, heard)),
            "the worker's end is told", 20,
        )  # fmt: skip
        until(lambda: levels(program, heard).get("worker modules") == 0, "it is up again", 40)
