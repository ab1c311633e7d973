"""The router for other machines: the permissions of a trusted machine, a guest and a stranger."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from bridge.config.model import Config
from bridge.hub.errors import HubError
from bridge.hub.node import Hub
from bridge.hub.router import RouterWorker
from bridge.hub.security.certificates import Authority, trouble
from bridge.hub.security.external_router import ExternalRouter
from bridge.hub.security.key_files import KeyFiles
from bridge.hub.wire.keys import pack_attachment, topic_key
from tests.peers.hub.endpoints import HASH, LATCHED, TYPE, Subscriber, advertise, matched, see_each_other
from tests.peers.hub.machines import FLOAT, Machines, make_keys
from tests.support.ports import free_port
from tests.support.wait import until

TWIST, POSE = "geometry_msgs/msg/Twist", "geometry_msgs/msg/PoseStamped"
GOAL = f"0/go/_action/send_goal/nav2_msgs::action::dds_::NavigateToPose_SendGoal_/{HASH}"
CANCEL = f"0/go/_action/cancel_goal/action_msgs::srv::dds_::CancelGoal_/{HASH}"
RESULT = f"0/go/_action/get_result/nav2_msgs::action::dds_::NavigateToPose_GetResult_/{HASH}"
ATTACHMENT = pack_attachment(1, 1, bytes(16))


def key(topic: str, type_name: str) -> str:
    return topic_key(0, topic, type_name, HASH)


CMD_VEL, ARM_DRIVE = key("/cmd_vel", TWIST), key("/arm/drive", FLOAT)
ACTIONLIB_GOAL = key("/move_base/goal", "move_base_msgs/msg/MoveBaseActionGoal")
ACTIONLIB_CANCEL = key("/move_base/cancel", "actionlib_msgs/msg/GoalID")
COMMANDS = [
    CMD_VEL,
    key("/robot/drive", "geometry_msgs/msg/TwistStamped"),
    ARM_DRIVE,
    ACTIONLIB_GOAL,
    ACTIONLIB_CANCEL,
    key("/move_base_simple/goal", POSE),
    key("/goal_pose", POSE),
]
FORGED = [
    "**",
    "0/**",
    "0/cmd_vel/**",
    "0/*/*/*",
    f"0/cmd_vel/*/{HASH}",
    f"0/cmd_vel/$*Twist_/{HASH}",
    f"0/cmd_vel/geometry_msgs$*/{HASH}",
    "0/cmd_vel/geometry_msgs::msg::dds_::Twist_/*",
    "*/*/geometry_msgs::msg::dds_::Twist_/*",
    f"0/**/{FLOAT.replace('/', '::').replace('msg::', 'msg::dds_::')}_/{HASH}",
    f"0/goal_pos$*/geometry_msgs::msg::dds_::PoseStamped_/{HASH}",
    f"0/**/geometry_msgs::msg::dds_::PoseStamped_/{HASH}",
]
HARMLESS = [
    key("/scan", "sensor_msgs/msg/LaserScan"),
    key("/odom", "nav_msgs/msg/Odometry"),
    key("/tf", "tf2_msgs/msg/TFMessage"),
    key("/robot/pose", POSE),
    key("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped"),
    key("/speed", "geometry_msgs/msg/TwistWithCovarianceStamped"),
    key("/arm/angle", FLOAT),
    key("/move_base/status", "actionlib_msgs/msg/GoalStatusArray"),
    key("/own/kind", "a_package_of_ours/msg/Thing2"),
]


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a router answer its own check late, as on a busy machine."""
    monkeypatch.setattr("bridge.hub.router._ANSWER_SECONDS", 40.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_keys(tmp_path_factory.mktemp("keys"))


@pytest.fixture(scope="module")
def running(folder: Path) -> Iterator[Machines]:
    machines = Machines(folder)
    with machines.network:
        machines.network.start_router()
        yield machines


@pytest.fixture
def machines(running: Machines) -> Iterator[Machines]:
    yield running
    running.close()


class RobotProgram:
    """Records everything that a program on the robot's machine receives, by any means."""

    def __init__(self, session: zenoh.Session) -> None:
        self.received: list[tuple[str, str]] = []
        self._open = [  # whoever knows the subscriber, also knows the queryable
            session.declare_queryable("0/**", self._on_query, complete=True),
            session.declare_subscriber("**", self._on_sample),
        ]

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self.received.append((str(sample.key_expr), sample.payload.to_string()))

    def _on_query(self, query: zenoh.Query) -> None:
        with query:
            self.received.append((str(query.key_expr), "query"))
            query.reply(query.key_expr, b"done")


def received_from(
    machines: Machines, name: str, send: Callable[[zenoh.Session], None], mode: str = "client"
) -> list[tuple[str, str]]:
    """Return what the robot receives from a machine, up to a harmless last message."""
    robot = RobotProgram(machines.session(None))
    sender = machines.session(name, mode)
    last = key("/last", TYPE)
    until(lambda: sender.put(last, b"hello") or robot.received, "the machine is connected")
    send(sender)
    sender.put(last, b"end")
    until(lambda: (last, "end") in robot.received, "the last message arrives")
    return [message for message in robot.received if message[0] != last]


def put_each(keys: list[str]) -> Callable[[zenoh.Session], None]:
    def send(sender: zenoh.Session) -> None:
        for key_expr in keys:
            sender.put(key_expr, b"go", attachment=ATTACHMENT)
            sender.delete(key_expr)

    return send


def test_commands_of_a_trusted_machine_are_delivered(machines: Machines) -> None:
    messages = received_from(machines, "friend", put_each(COMMANDS + HARMLESS))
    assert [entry for entry in messages if entry[1]] == [(entry, "go") for entry in COMMANDS + HARMLESS]


@pytest.mark.parametrize("mode", ["client", "peer", "router"])
def test_guest_publishes_everything_but_commands(machines: Machines, mode: str) -> None:
    messages = received_from(machines, "guest", put_each(COMMANDS + FORGED + HARMLESS), mode)
    assert messages == [(key_expr, "go") for key_expr in HARMLESS]


def test_a_guest_cannot_borrow_a_name(machines: Machines) -> None:
    """Naming another sender in a sample, or declaring another session's tokens, grants no permission."""
    friend = machines.session("friend")

    def send(sender: zenoh.Session) -> None:
        source = friend.declare_publisher(CMD_VEL)
        token = f"@ros2_lv/0/{friend.zid()}/0/9/MP/%/%/boss/%cmd_vel/geometry_msgs::msg::dds_::Twist_/{HASH}/::,:,:,:,,"
        tokens = [sender.liveliness().declare_token(name) for name in (token, f"{CMD_VEL}/@adv/pub/{friend.zid()}/7/_")]
        sender.put(CMD_VEL, b"go", attachment=ATTACHMENT, source_info=zenoh.SourceInfo(source.id, 5))
        publisher = sender.declare_publisher(CMD_VEL)
        publisher.put(b"go", attachment=ATTACHMENT)
        advanced = zenoh.ext.declare_advanced_publisher(
            sender, CMD_VEL, cache=zenoh.ext.CacheConfig(3), publisher_detection=True
        )
        advanced.put(b"go")
        sender.put(f"{CMD_VEL}/@adv/pub/{friend.zid()}/7/_", b"go")
        for declared in tokens:
            declared.undeclare()

    assert received_from(machines, "guest", send) == []


@pytest.mark.parametrize(("name", "works"), [("friend", True), ("guest", False)])
def test_only_a_trusted_machine_calls_goal_and_cancel_services(machines: Machines, name: str, works: bool) -> None:
    answered: list[str] = []

    def ask(sender: zenoh.Session) -> None:
        services = [GOAL, CANCEL, key("/stop", "std_srvs/srv/SetBool"), "0/go/_action/**", "0/**"]
        for key_expr in [*services, RESULT, key("/map_server/map", "nav_msgs/srv/GetMap")]:
            replies = sender.get(key_expr, target=zenoh.QueryTarget.ALL, timeout=10.0)
            answered.extend(str(reply.ok.key_expr) for reply in replies if reply.ok)

    received = [key_expr for key_expr, _ in received_from(machines, name, ask)]
    assert answered == received
    assert {GOAL, CANCEL} & set(received) == ({GOAL, CANCEL} if works else set())
    assert {RESULT, key("/map_server/map", "nav_msgs/srv/GetMap")} <= set(received)
    assert (len(received) == 2) is not works


def test_a_guest_cannot_answer_with_commands(machines: Machines) -> None:
    """Caches of latched samples are queried below their key. Only trusted machines are queried for commands."""
    local = machines.session(None)
    guest = machines.session("guest")
    state, goal = key("/state", TYPE), key("/goal_pose", POSE)

    def answer(query: zenoh.Query) -> None:
        with query:
            for key_expr in (goal, "0/**", ACTIONLIB_GOAL, state):
                query.reply(key_expr, b"go")

    for key_expr in (state, goal):
        guest.declare_queryable(f"{key_expr}/@adv/pub/{guest.zid()}/7/_/**", answer)
    guest.declare_queryable("**/@adv/**", answer)
    guest.declare_queryable("0/goal_pose/**/@adv/**", answer)

    def ask(key: str) -> list[str]:
        replies = local.get(
            f"{key}/@adv/pub/**",
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            accept_replies=zenoh.ReplyKeyExpr.ANY,
            timeout=10.0,
        )
        return [str(reply.ok.key_expr) for reply in replies if reply.ok]

    assert set(until(lambda: ask(state), "the guest answers")) == {state}
    assert ask(goal) == []


def test_strangers_and_machines_without_a_certificate_cannot_join(machines: Machines) -> None:
    for name in ("stranger", ""):
        with pytest.raises(HubError, match="cannot join the hub"):
            machines.hub(name)


def test_guests_exchange_state_in_both_directions(machines: Machines) -> None:
    robot = Hub.open(machines.network.settings("robot"))
    with robot, machines.hub("guest") as guest:
        see_each_other(robot, guest)
        advertise(robot, "/map", LATCHED, "of the robot")
        advertise(guest, "/plan", LATCHED, "of the guest")
        Subscriber(guest, "/map", LATCHED).expect("of the robot")
        Subscriber(robot, "/plan", LATCHED).expect("of the guest")
        subscriber, stream = Subscriber(robot, "/chat"), advertise(guest, "/chat")
        matched(stream)
        stream.put(b"hello")
        subscriber.expect("hello")
        assert robot.ask("nothing", {}, timeout=0.5) == []


def test_router_reports_connected_machines(machines: Machines) -> None:
    robot = Hub.open(machines.network.settings("robot"))
    with robot, machines.hub("guest"), machines.hub("friend"):

        def connected() -> list[tuple[str, bool]]:
            answers = robot.ask("status", {}, worker="router")
            return [(machine["name"], machine["trusted"]) for a in answers for machine in a.value["machines"]]

        until(lambda: connected() == [("friend", True), ("guest", False)], "both connections are reported")


def test_reload_changes_the_trusted_machines(folder: Path) -> None:
    machines = Machines(folder)
    config = Config.model_validate({"name": "test", "hub": machines.network.config(open=machines.network.external)})
    router = RouterWorker()
    router.start(config)
    try:
        assert [name for name, _ in received_from(machines, "friend", put_each([CMD_VEL])) if name] == [CMD_VEL] * 2
        opened = config.hub.open.model_copy(update={"trusted": ("guest",)})
        changed = config.model_copy(update={"hub": config.hub.model_copy(update={"open": opened})})
        local = machines.session(None)
        assert router.reload(changed)
        assert [str(zid) for zid in local.info.routers_zid()], "this machine's programs stay connected"
        assert received_from(machines, "friend", put_each([CMD_VEL])) == []
        assert (ARM_DRIVE, "go") in received_from(machines, "guest", put_each([ARM_DRIVE]))
    finally:
        machines.close()
        router.stop()


def shown(machines: Machines) -> bytes:
    """Return the certificate that the robot's external router presents."""
    context = ssl.create_default_context(cafile=machines.folder / "ca.pem")
    context.load_cert_chain(machines.folder / "friend.pem", machines.folder / "friend.key")
    address = ("127.0.0.1", machines.port)
    with (
        socket.create_connection(address, 40.0) as plain,
        context.wrap_socket(plain, server_hostname="127.0.0.1") as tls,
    ):
        return tls.getpeercert(binary_form=True) or b""


def test_new_certificates_are_used_once_they_match(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    authority = Authority(tmp_path)
    authority.make()
    for name in ("test", "friend"):
        authority.issue(name, ["127.0.0.1"])
    machines = Machines(tmp_path)
    router = RouterWorker()
    hub = machines.network.config(open=machines.network.external)
    router.start(Config.model_validate({"name": "test", "hub": hub}))
    try:
        first, local = shown(machines), machines.session(None)
        for _ in range(3):
            router.health()
        assert shown(machines) == first

        renewed = Authority(tmp_path).issue("test", ["127.0.0.1"], replace=True)
        whole = renewed.file.read_bytes()
        renewed.file.write_bytes((tmp_path / "friend.pem").read_bytes())
        for _ in range(3):
            router.health()
        assert shown(machines) == first
        assert caplog.text.count("the new certificates cannot be used, the old ones stay in use") == 1

        renewed.file.write_bytes(whole)
        router.health()
        assert shown(machines) == first, "the certificate might not be copied completely yet"
        router.health()
        assert shown(machines) == ssl.PEM_cert_to_DER_cert(whole.decode()) != first
        assert [str(zid) for zid in local.info.routers_zid()], "this machine's programs stay connected"
        assert received_from(machines, "friend", put_each([CMD_VEL])) == [(CMD_VEL, "go"), (CMD_VEL, "")]
    finally:
        machines.close()
        router.stop()


def test_the_authority_is_replaced_while_machines_stay_connected(tmp_path: Path) -> None:
    """The steps of docs/operate/security.md, with the robot's and the friend's certificates in one folder."""
    old, new = Authority(tmp_path), Authority(tmp_path / "new")
    for authority in (old, new):
        authority.make()
        for name in ("test", "friend"):
            authority.issue(name, ["127.0.0.1"])
    machines = Machines(tmp_path)
    router = RouterWorker()
    router.start(
        Config.model_validate({"name": "test", "hub": machines.network.config(open=machines.network.external)})
    )
    files = KeyFiles(tmp_path / "ca.pem", tmp_path / "test.pem", tmp_path / "test.key")
    before, after = (folder / "ca.pem" for folder in (old.folder, new.folder))
    try:
        for copied in (
            {"ca.pem": before.read_bytes() + after.read_bytes()},
            {name: (new.folder / name).read_bytes() for name in ("test.pem", "test.key")},
            {name: (new.folder / name).read_bytes() for name in ("friend.pem", "friend.key")},
            {"ca.pem": after.read_bytes()},
        ):
            for name, content in copied.items():
                (tmp_path / name).write_bytes(content)
            for _ in range(3):
                assert "cannot be used" not in router.health().text, list(copied)
            assert trouble(files) == "", "the doctor and the console accept the files, too"
            assert received_from(machines, "friend", put_each([CMD_VEL])) == [(CMD_VEL, "go"), (CMD_VEL, "")]
            machines.close()
        assert shown(machines) == ssl.PEM_cert_to_DER_cert((new.folder / "test.pem").read_text())
    finally:
        machines.close()
        router.stop()


def test_hub_runs_if_its_external_listener_cannot_open(folder: Path, tmp_path: Path) -> None:
    machines = Machines(folder)
    hub = machines.network.config(open={**machines.network.external, "keys": str(tmp_path)})
    config = Config.model_validate({"name": "test", "hub": hub})
    router = RouterWorker()
    router.start(config)
    try:
        with Hub.open(machines.network.settings("robot")) as robot:
            until(robot.graph.nodes, "the session is seen")
            health = router.health()
            assert health.state == "running"
            assert f"closed to other machines: there is no {tmp_path / 'ca.pem'}" in health.text
            assert "midspan keys make" in health.text
    finally:
        router.stop()


@pytest.mark.parametrize(
    ("file", "content", "reason"),
    [
        ("test.pem", b"", "{file} is not a certificate (PEM)"),
        ("test.pem", b"rubbish\xff", "{file} is not a certificate (PEM)"),
        ("ca.pem", b"", "{file} is not a certificate (PEM)"),
        ("test.key", b"", "{file} cannot be used: "),
        ("test.key", None, "{file} is not the key of {folder}/test.pem"),
    ],
)
def test_the_file_that_keeps_the_external_listener_closed_is_named(
    tmp_path: Path, file: str, content: bytes | None, reason: str
) -> None:
    authority = Authority(tmp_path)
    authority.make()
    for name in ("test", "friend"):
        authority.issue(name, ["127.0.0.1"])
    machines = Machines(tmp_path)
    (tmp_path / file).write_bytes((tmp_path / "friend.key").read_bytes() if content is None else content)
    hub = machines.network.config(open=machines.network.external)
    with pytest.raises(HubError) as refused:
        ExternalRouter(Config.model_validate({"name": "test", "hub": hub}))
    expected = reason.format(file=tmp_path / file, folder=tmp_path)
    assert str(refused.value).partition(f"{machines.network.external['listen'][0]}: ")[2].startswith(expected)
    machines.close()


@pytest.mark.parametrize(
    ("over", "place"),
    [
        ({"listen": {"endpoints": ["tcp/0.0.0.0:0"]}}, "tcp/0.0.0.0:0"),
        ({"connect": {"endpoints": ["tls/robot1:7448"]}}, "tls/robot1:7448"),
        ({"connect": {"endpoints": {"router": ["tcp/10.9.9.9:7447"]}}}, "tcp/10.9.9.9:7447"),
    ],
)
def test_the_router_of_this_machine_stays_closed(over: dict[str, Any], place: str) -> None:
    config = Config.model_validate({"hub": {"listen": f"tcp/127.0.0.1:{free_port()}", "router_zenoh": over}})
    with pytest.raises(RuntimeError, match=f"hub.router_zenoh: .*{place}.*hub.open"):
        RouterWorker().start(config)
