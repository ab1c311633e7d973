"""``midspan status`` and ``midspan top`` on a real hub."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bridge.cli.main import main
from tests.cli.conftest import Midspan
from tests.peers.daemon.workers import EngineWorker, FakeWorker, config_file, route, status
from tests.peers.hub.network import HubNetwork
from tests.support.ports import free_port

REFUSED = {
    "direction": "in",
    "topic": "/odd",
    "type": "odd_msgs/Odd",
    "reason": "odd_msgs is not known",
    "cure": "get it",
}

SHARED = {"ros1": "/nav", "node": "/nav", "owner": "ros2", "shared": 3, "skipped": ["qos_overrides./scan.depth", "a-b"]}


@pytest.fixture
def workers(network: HubNetwork, closing: list[FakeWorker | EngineWorker]) -> None:
    routes = [route("/scan"), route("/odd\x1b[2J", error="bad\x07bell")]
    ros1 = status("ros1", routes=routes, refused=[REFUSED], parameters=[SHARED, {**SHARED, "skipped": []}])
    ros2 = status("ros2", state="waiting", network=None, routes=[route("/scan", "out", state="idle", age=None)])
    router = status("router", side="router", listen="tcp/127.0.0.1:1", sessions=3)
    gateway = status("gateway", side=None, state="waiting", network=None, text="the planner is not available")
    documents = (ros1, ros2, router, gateway)
    closing.extend(FakeWorker(network, document["worker"], status=document) for document in documents)


@pytest.mark.usefixtures("workers")
def test_status_shows_each_worker_and_route(midspan: Midspan) -> None:
    done = midspan("status")
    assert done.code == 0
    output = done.out
    for text in (
        "robot1",
        "network net-1",
        "ROS 2 is unavailable",
        "3 sessions",
        "refused ROS 1 -> hub /odd (odd_msgs/Odd)",
    ):
        assert text in output
    skipped = "parameters of /nav whose names are not valid in ROS 1: qos_overrides./scan.depth, a-b\n"
    assert output.count("parameters of /nav") == output.count(skipped) == 1
    assert "gateway  waiting  the planner is not available" in output
    for text in ("cure: get it", "hub -> ROS 2", "queue 3, bad 1", "9.8", "12", "idle", "up 3 min", "cpu 3 %", "52 MB"):
        assert text in output
    assert "bad?bell" in output
    assert "\x1b" not in output


@pytest.mark.usefixtures("workers")
def test_status_as_json_prints_the_documents(midspan: Midspan) -> None:
    documents = midspan("status", "--json").json()
    assert [d["worker"] for d in documents] == ["gateway", "ros1", "ros2", "router"]
    assert documents[1]["refused"] == [REFUSED]


def test_one_cause_is_one_line_with_what_it_affects(
    midspan: Midspan, network: HubNetwork, closing: list[FakeWorker]
) -> None:
    deaf = [f"/t{number}: /rviz gets no messages: it asks for reliable" for number in range(20)]
    full = "the state folder /var/lib/midspan: no space left on device"
    lost = [route(f"/r{number}", error="no server of /cancel_goal is on the hub") for number in range(9)]
    odd = [{**REFUSED, "topic": f"/odd{number}"} for number in range(20)]
    closing.append(FakeWorker(network, "ros1", status=status("ros1", warnings=[*deaf, full], refused=odd)))
    closing.append(FakeWorker(network, "ros2", status=status("ros2", warnings=[full], routes=lost)))
    out = midspan("status").out
    lines = [line.strip() for line in out.splitlines()]
    assert f"warning: {deaf[0]} (the same for /t1, /t2, /t3, /t4, /t5 and 14 more)" in lines
    assert f"warning of ros1, ros2: {full}" in lines
    same = "(the same for /odd1, /odd2, /odd3, /odd4, /odd5 and 14 more)"
    assert f"refused ROS 1 -> hub /odd0 (odd_msgs/Odd): odd_msgs is not known {same}" in lines
    assert [out.count(text) for text in ("gets no messages", full, "odd_msgs is not known", "cure: get it")] == [1] * 4
    assert out.count("no server of /cancel_goal") == 1
    assert "(the same for /r1, /r2, /r3, /r4, /r5 and 3 more)" in " ".join(out.split())
    documents = midspan("status", "--json").json()
    assert documents[0]["warnings"] == [*deaf, full], "the JSON document has the full text"
    report = midspan("doctor", "--only", "daemon", "--only", "types").out
    assert [report.count(text) for text in ("gets no messages", full, "odd_msgs is not known")] == [1] * 3


def test_a_worker_that_fails_to_answer_is_shown(midspan: Midspan, network: HubNetwork, closing: list[Any]) -> None:
    def fail(_params: dict[str, Any]) -> None:
        msg = "the engine stands still"
        raise RuntimeError(msg)

    closing.append(FakeWorker(network, "ros1", status=fail))
    done = midspan("status")
    assert done.code == 0
    assert "the engine stands still" in done.out


@pytest.mark.parametrize("verb", ["status", "top"])
def test_the_cause_is_reported_if_no_worker_or_router_answers(
    tmp_path: Path, network: HubNetwork, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    config = config_file(tmp_path, network)
    done = Midspan(config, capsys)(verb)
    assert done.code == 1
    assert "no Midspan worker" in done.err
    assert f"domain {network.domain}" in done.err

    nobody = f"tcp/127.0.0.1:{free_port()}"
    done = Midspan(config, capsys)(verb, "--router", nobody)
    assert done.code == 1
    assert nobody in done.err
    assert "Is the daemon running?" in done.err


@pytest.mark.usefixtures("workers")
def test_top_without_a_terminal_prints_once(midspan: Midspan) -> None:
    done = midspan("top")
    assert done.code == 0
    assert "ROS 1 -> hub" in done.out
    assert "robot1/ros2 waiting" in done.out


@pytest.mark.usefixtures("workers")
def test_top_as_json_prints_one_line(midspan: Midspan) -> None:
    (documents,) = midspan("top", "--once", "--json").lines()
    assert {d["worker"] for d in documents} == {"ros1", "ros2", "router", "gateway"}


def test_routes_of_two_daemons_name_their_daemon(midspan: Midspan, network: HubNetwork, closing: list[Any]) -> None:
    for daemon in ("robot1", "robot2"):
        document = status("ros1", daemon=daemon, routes=[route("/scan")])
        closing.append(FakeWorker(network, "ros1", daemon=daemon, status=document))
    lines = midspan("top", "--once").out.splitlines()
    assert [line.split()[0] for line in lines if "/scan" in line] == ["robot1", "robot2"]


@pytest.mark.parametrize(
    "text",
    ["name: a\nros1: {masterr: x}\nzzz: 1\n", "name: [", "hub: {listen: 7}\n", "types: {folders: [/nowhere]}\n"],
    ids=["unknown keys", "no YAML", "wrong type", "missing folder"],
)
@pytest.mark.parametrize("words", [["status"], ["topic", "list"], ["status", "--json"]], ids=" ".join)
def test_named_hub_is_used_despite_a_broken_file(
    network: HubNetwork, closing: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], text: str, words: list[str],
) -> None:  # fmt: skip
    closing.append(FakeWorker(network, "ros1", status=status("ros1"), explain=[]))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MIDSPAN_CONFIG", raising=False)
    (tmp_path / "midspan.yaml").write_text(text)
    hub = ["--router", network.endpoint, "--hub-domain", str(network.domain)]
    assert main([*words, *hub]) == 0
    printed = capsys.readouterr()
    assert "robot1" in printed.out or words[0] == "topic"
    assert printed.err.startswith("midspan: warning: midspan.yaml:")
    assert printed.err.endswith("; the file is ignored, because --router names the hub\n")
    assert len(printed.err.splitlines()) == 1
    assert main(["doctor", "--only", "config", *hub]) == 1
    assert "midspan.yaml is valid" not in capsys.readouterr().out
    for named in ([], ["--config", "midspan.yaml", *hub], hub[2:]):
        assert main([*words, *named]) == 1
        assert "is ignored" not in capsys.readouterr().err
