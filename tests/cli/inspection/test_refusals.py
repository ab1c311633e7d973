"""Commands that a machine's router refuses, as status, explain and the publishing verbs report them on a real hub."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from bridge.config.rules import ALWAYS
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.hub.zenoh_config import make_config, router_tree
from tests.bags.playing import Said, write_bag
from tests.cli.conftest import Midspan, Outcome
from tests.peers.daemon.workers import FakeWorker, config_file, route, status
from tests.peers.hub.machines import Machines, make_keys
from tests.peers.hub.network import HubNetwork
from tests.support.ports import free_port
from tests.support.wait import until
from tests.support.zenoh_router import open_router

SET_BOOL, GET_PLAN = "std_srvs/srv/SetBool", "nav_msgs/srv/GetPlan"
TWIST, LASER = "geometry_msgs/msg/Twist", "sensor_msgs/msg/LaserScan"
HASH = "RIHS01_" + "1" * 64
COMMANDS = {name: [part] for name, part in ALWAYS.items()}


def router(daemon: str, **more: Any) -> dict[str, Any]:
    return status("router", daemon=daemon, side="router", listen="tcp/127.0.0.1:1", sessions=1, **more)


class Fleet:
    """A robot, and an operator whom it does not trust and whose worker publishes commands and a scan."""

    def __init__(self, network: HubNetwork, closing: list[Any], name: str = "operator1") -> None:
        self.worker = FakeWorker(network, "ros1", daemon="operator1", explain=[], status=lambda _: self.document)
        zid = self.worker.hub.zid
        self.document = status("ros1", daemon="operator1", zid=zid, routes=[route("/cmd_vel", messages=153)])
        for topic, type_name in (("/cmd_vel", TWIST), ("/scan", LASER)):
            self.worker.endpoints.append(self.worker.hub.publisher(topic, type_name, HASH, Qos()))
        self.machine = {"name": name, "zid": "d1", "address": "tls/10.0.0.2:1", "trusted": False}
        self.robot = router("robot1", door="d2", machines=[self.machine], commands=COMMANDS)
        self.operator = router("operator1", door="d1", members=[zid, "d1"], machines=[])
        closing += [
            self.worker,
            FakeWorker(network, "router", daemon="robot1", status=lambda _: self.robot),
            FakeWorker(network, "router", daemon="operator1", status=lambda _: self.operator),
        ]


def test_refused_commands_are_reported_with_count_and_cure(
    midspan: Midspan, network: HubNetwork, closing: list[Any]
) -> None:
    Fleet(network, closing)
    refusal_line = "robot1 refuses the commands of operator1 on /cmd_vel (/midspan_ros1); 153 messages so far"
    cure = "cure: if that is not intended, name 'operator1' in hub.open.trusted of robot1 and reload"
    for output in (midspan("explain", "/cmd_vel").out, midspan("status").out):
        assert refusal_line in " ".join(output.split())
        assert cure in " ".join(output.split())
    assert "refuses" not in midspan("explain", "/scan").out
    assert "/scan" not in midspan("status").out.partition("direction")[0]
    (document,) = [d for d in midspan("status", "--json").json() if d.get("refused_commands")]
    assert document["daemon"] == "robot1"
    (refusal,) = document["refused_commands"]
    assert (refusal["topic"], refusal["machine"], refusal["messages"]) == ("/cmd_vel", "operator1", 153)


def test_only_refused_calls_are_reported(midspan: Midspan, network: HubNetwork, closing: list[Any]) -> None:
    fleet = Fleet(network, closing)
    robot = FakeWorker(network, "ros1")
    closing.append(robot)
    calls = {"/lamp": 2, "/plan": 3, "/quiet": 0, "/gone": 4}
    fleet.document["routes"] += [route(name, "out", kind="service", calls=count) for name, count in calls.items()]
    types = {name: GET_PLAN if name == "/plan" else SET_BOOL for name in calls}
    for name, type_name in types.items():
        fleet.worker.endpoints.append(fleet.worker.hub.client(name, type_name, HASH))
        if name != "/gone":
            robot.endpoints.append(robot.hub.server(name, type_name, HASH, lambda _request, _done: lambda: None))
    output = " ".join(midspan("status").out.split())
    assert "robot1 refuses the calls of operator1 to /lamp (/midspan_ros1); 2 calls so far" in output
    assert output.count("refuses the calls") == 1  # GetPlan only reads, and /quiet and /gone have no refused calls
    assert "2 calls so far. cure: if that is not intended, name" in " ".join(midspan("explain", "/lamp").out.split())


@pytest.mark.parametrize("place", ["beyond a router", "beyond two routers", "program", "other link", "trusted link"])
def test_explain_names_the_other_router_whose_commands_are_refused(
    midspan: Midspan, network: HubNetwork, closing: list[Any], place: str
) -> None:
    """The robot is connected to a router without a status document, such as zenohd with TLS, and does not trust it."""
    fleet = Fleet(network, closing, name="middle")
    fleet.machine["zid"] = "m1"
    fleet.operator["machines"] = [{"name": "middle", "zid": "m2" if place == "beyond two routers" else "m1"}]
    if place == "beyond two routers":
        station = router("station", door="d3", machines=[{"name": "m", "zid": "m1"}, {"name": "m", "zid": "m2"}])
        closing.append(FakeWorker(network, "router", daemon="station", status=station))
    elif place == "program":  # the program is connected to that router itself, so no status document has its session
        fleet.operator |= {"door": "", "members": [], "machines": []}
        fleet.robot["members"] = ["d2"]
    elif place == "other link":
        fleet.robot["machines"] = [fleet.machine, {"name": "operator1", "zid": "d1", "trusted": True}]
    elif place == "trusted link":
        fleet.machine["trusted"] = True
    output = " ".join(midspan("explain", "/cmd_vel").out.split())
    refused = "robot1 refuses the commands of middle on /cmd_vel (/midspan_ros1)"
    assert (refused in output) == (place not in ("other link", "trusted link"))


def test_sessions_of_a_robot_use_its_own_router(midspan: Midspan, network: HubNetwork, closing: list[Any]) -> None:
    fleet = Fleet(network, closing, name="middle")
    fleet.machine["zid"] = "m1"
    fleet.operator |= {"door": "", "members": [], "machines": []}
    fleet.robot["members"] = ["d2", fleet.worker.hub.zid]
    assert "refuses" not in midspan("explain", "/cmd_vel").out


def test_commands_of_a_trusted_machine_are_not_reported(
    midspan: Midspan, network: HubNetwork, closing: list[Any]
) -> None:
    Fleet(network, closing).machine["trusted"] = True
    assert "refuses" not in midspan("explain", "/cmd_vel").out + midspan("status").out


def test_refusals_of_a_program_without_a_router_have_no_count(
    midspan: Midspan, network: HubNetwork, closing: list[Any]
) -> None:
    fleet = Fleet(network, closing, name="")
    fleet.machine["zid"] = fleet.worker.hub.zid
    fleet.document = status("ros1", daemon="operator1", zid="other")
    output = " ".join(midspan("explain", "/cmd_vel").out.split())
    assert "robot1 refuses the commands of a machine without a certificate on /cmd_vel (/midspan_ros1). cure:" in output
    assert "give it a certificate (midspan keys)" in output


@pytest.mark.parametrize("table", [None, "rubbish", {"no type": 5}, {TWIST: None}, {LASER: ["$*#", "**"]}])
def test_router_that_omits_its_command_topics_has_the_default_ones(
    midspan: Midspan, network: HubNetwork, closing: list[Any], table: Any
) -> None:
    fleet = Fleet(network, closing)
    robot = router("robot2", door="d3", machines=[fleet.machine], commands=table)
    closing.append(FakeWorker(network, "router", daemon="robot2", status=robot))
    assert "robot2 refuses the commands of operator1 on /cmd_vel" in " ".join(midspan("status").out.split())
    assert "robot2 refuses the commands of operator1 on /scan" not in midspan("status").out


@contextmanager
def robot(folder: Path) -> Iterator[Machines]:
    """A robot whose external router trusts only ``friend``."""
    machines = Machines(make_keys(folder))
    with machines.network:
        machines.network.start_router()
        yield machines
        machines.close()


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    with robot(tmp_path_factory.mktemp("keys")) as machines:
        yield machines


@pytest.fixture
def new_host(tmp_path: Path) -> Iterator[Machines]:
    """The same, but no other router has left it: zenoh sends its state to a router that joins."""
    with robot(tmp_path / "keys") as machines:
        yield machines


def commander(host: Machines, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """The command line of a machine whose certificate has this name."""
    file = tmp_path / "midspan.yaml"
    file.write_text(json.dumps({"name": name, "hub": {"zenoh": host.zenoh_config(name)}}))
    midspan = Midspan(file, capsys)
    return lambda *words: midspan(*words, "--router", host.place)


@pytest.mark.parametrize(
    ("topic", "type_name"),
    [
        ("/cmd_vel", "geometry_msgs/Twist"),
        ("/base/drive", "geometry_msgs/msg/TwistStamped"),
        ("/goal_pose", "geometry_msgs/PoseStamped"),
        ("/arm/drive", "std_msgs/Float64"),
    ],
)
def test_commands_published_by_an_untrusted_machine_are_reported(
    host: Machines, tmp_path: Path, capsys: pytest.CaptureFixture[str], topic: str, type_name: str
) -> None:
    quick = ("--once", "--settle", "0")
    done = commander(host, "guest", tmp_path, capsys)("topic", "pub", topic, type_name, *quick)
    assert done.code == 1
    assert f"midspan: warning: test refuses the commands of guest on {topic} (this command)" in done.err
    assert "name 'guest' in hub.open.trusted of test and reload" in done.err
    done = commander(host, "friend", tmp_path, capsys)("topic", "pub", topic, type_name, *quick)
    assert (done.code, "refuses" in done.err) == (0, False)


def test_allowed_topics_of_an_untrusted_machine_are_not_reported(
    host: Machines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    guest = commander(host, "guest", tmp_path, capsys)
    for topic, type_name in (("/scan", "sensor_msgs/LaserScan"), ("/arm/angle", "std_msgs/Float64")):
        done = guest("topic", "pub", topic, type_name, "--once", "--settle", "0")
        assert (done.code, "refuses" in done.err) == (0, False), done


def test_halt_reports_a_machine_that_refuses_its_zeros(
    host: Machines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Hub.open(host.network.settings("base")) as base:
        subscription = base.subscription("/cmd_vel", TWIST, "*", Qos(), lambda _sample: None)
        done = commander(host, "guest", tmp_path, capsys)("halt", "--seconds", "0.1")
        subscription.close()
    assert done.code == 1
    assert "test refuses the commands of guest on /cmd_vel (this command)" in done.err


def test_play_reports_a_machine_that_refuses_its_commands(
    host: Machines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    moves = [Said(0.1, topic, "geometry_msgs/Twist", {}) for topic in ("/cmd_vel", "/base/drive")]
    bag = write_bag(tmp_path / "run.bag", [Said(0.0, "/said", "std_msgs/String", {"data": "hi"}), *moves])
    play = ("play", str(bag), "--settle", "0s", "--commands")
    done = commander(host, "guest", tmp_path, capsys)(*play)
    refused = [line for line in done.err.splitlines() if "refuses" in line]
    assert sorted(line.partition(" (")[0] for line in refused) == [
        f"midspan: warning: test refuses the commands of guest on {topic}" for topic in ("/base/drive", "/cmd_vel")
    ]
    for name, command in (("friend", play), ("guest", play[:-1])):
        assert "refuses" not in commander(host, name, tmp_path, capsys)(*command).err


def test_a_command_reports_that_its_machine_is_refused(
    host: Machines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command joins its own machine's hub, which is connected to the robot's external listener."""
    hub = {"connect": [host.place], "keys": str(host.folder), "certificate": str(host.folder / "guest.pem")}
    with HubNetwork(run=False, external={**hub, "key": str(host.folder / "guest.key")}) as operator_network:
        operator_network.start_router()
        midspan = Midspan(config_file(tmp_path, operator_network), capsys)

        def refused() -> bool:
            done = midspan("topic", "pub", "/cmd_vel", "geometry_msgs/Twist", "--once", "--settle", "0")
            return done.code == 1 and "test refuses the commands of guest on /cmd_vel (this command)" in done.err

        until(refused, "the machines are linked, and the robot's refusal is reported", 30)


def test_explain_reports_a_foreign_router_to_the_commanding_machine(
    new_host: Machines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machines are connected through a TLS router like zenohd; `explain` reports it to the commanding machine."""
    place = f"tls/127.0.0.1:{free_port()}"
    guest = {
        name: str(new_host.folder / f"guest.{end}") for name, end in (("certificate", "pem"), ("private_key", "key"))
    }
    tls = {f"{prefix}_{name}": file for prefix in ("listen", "connect") for name, file in guest.items()}
    tls |= {"root_ca_certificate": str(new_host.folder / "ca.pem"), "enable_mtls": True}
    tree = router_tree([place], max_payload=1 << 20)
    tree["connect"]["endpoints"] = [new_host.place]
    middle = open_router(make_config(tree, {"transport": {"link": {"tls": tls}}}))
    hub = {"connect": [place], "keys": str(new_host.folder), "certificate": str(new_host.folder / "friend.pem")}
    with HubNetwork(run=False, external={**hub, "key": str(new_host.folder / "friend.key")}) as operator_network:
        operator_network.start_router()
        with Hub.open(operator_network.settings("operator")) as operator:
            operator.publisher("/cmd_vel", TWIST, HASH, Qos())
            midspan = Midspan(config_file(tmp_path, operator_network), capsys)
            # the daemons of both machines have the same name here
            wanted = re.compile(r"test \(router \w+\) refuses the commands of guest on /cmd_vel \(/operator\)")
            until(
                lambda: wanted.search(" ".join(midspan("explain", "/cmd_vel").out.split())),
                "explain reports the router",
                30,
            )
    middle.close()
