"""Services and actions between every pair of sides, through one daemon, with real middlewares on both ends.

``python -m tests.peers.daemon.calls_table [--json FILE]`` prints the table, as does `test_calls_table`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.actions import HubActions
from tests.peers.peer import Peer
from tests.peers.zenoh import actions as zenoh_actions
from tests.peers.zenoh.programs import JsonProgram, Program, Ros1Bridge, Ros2ddsBridge, service_texts
from tests.peers.zenoh.ros2dds_actions import Ros2ddsActions
from tests.support.ports import free_port
from tests.support.rosbags_messages import Messages
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.pythonic import Client, Server

SECONDS = 40.0
SERVICE = "std_srvs/SetBool"
YARP_RPC = "/lamp/rpc:i"

ROS1 = "ROS 1 rospy, actionlib"
ROS2 = "ROS 2 rclpy"
ZENOH = "zenoh, zenoh-ros2-sdk"
ROS2DDS = "zenoh, ros2dds plugin"
ROS1_KEYS = "zenoh, ros1 plugin"
JSON = "zenoh, JSON"
YARP = "YARP RPC"
HUB = "zenoh, Midspan's module"
"""zenoh-ros2-sdk has no actions, so on the hub they end at the classes that Midspan's modules use. The actions of the
ros2dds plugin end at a bridge; see `tests.peers.zenoh.programs`."""

KEYS = {
    ROS1: "ros1", ROS2: "ros2", ZENOH: "zenoh", ROS2DDS: "ros2dds", ROS1_KEYS: "ros1_keys", JSON: "json", YARP: "yarp",
}  # fmt: skip
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


@dataclass(frozen=True)
class Line:
    """The results for one pair of sides."""

    kind: str
    server: str
    client: str
    passed: str
    failed: str
    seconds: float

    @property
    def good(self) -> bool:
        """Return whether everything crossed."""
        return not self.failed


class ServiceSide(Protocol):
    """A program that serves and calls services."""

    def serve(self, service: str, message: str) -> None:
        """Serve a service whose reply to True is success with this text."""

    def call(self, service: str, *, data: bool) -> dict[str, Any]:
        """Return the reply, or {} after an error."""


class RosServices:
    """Services of a peer program."""

    def __init__(self, peer: Peer | Program) -> None:
        self._peer = peer

    def serve(self, service: str, message: str) -> None:
        self._peer.ask("serve", service=service, type=SERVICE, reply={"success": True, "message": message})

    def call(self, service: str, *, data: bool) -> dict[str, Any]:
        call = self._peer.ask("call", service=service, type=SERVICE, request={"data": data})["id"]
        reported = self._peer.ask("result", id=call, seconds=SECONDS)
        return reported["reply"] or {}


class YarpServices:
    """A server on an RPC port, and clients of the RPC ports that stand for the hub's services."""

    def __init__(self, names: NameClient) -> None:
        self._names = names
        self._open: list[Any] = []

    def serve(self, service: str, message: str) -> None:  # noqa: ARG002 - a rule assigns the port to its service
        port = Server(YARP_RPC, lambda values: [int(values == [1]), message], naming=self._names)
        self._open.append(port.open())

    def call(self, service: str, *, data: bool) -> dict[str, Any]:
        port = f"/midspan{service}/rpc"
        until(lambda: connections.exists(self._names, port), f"{port} is there", SECONDS)
        with Client(port, naming=self._names) as client:
            values = client.ask([data], timeout=SECONDS)
        return {"success": values[0] == 1, "message": values[1]}

    def stop(self) -> None:
        """Close the ports."""
        for port in self._open:
            port.close()


class JsonServices:
    """Keys that a program without ROS serves and queries."""

    def __init__(self, program: JsonProgram) -> None:
        self._program = RosServices(program)

    def serve(self, service: str, message: str) -> None:
        self._program.serve(f"/json{service}", message)

    def call(self, service: str, *, data: bool) -> dict[str, Any]:
        return self._program.call(f"/json{service}", data=data)


TYPES = {ROS1: "move_base_msgs/MoveBase", ROS2: "nav2_msgs/NavigateToPose", HUB: "nav2_msgs/NavigateToPose"}
FIELDS = {ROS1: ("target_pose", "base_position"), ROS2: ("pose", "current_pose"), HUB: ("pose", "current_pose")}
LOOKUP = "tf2_msgs/LookupTransform"


def pose(x: float) -> dict[str, Any]:
    """Return a stamped pose in the map."""
    return {"header": {"frame_id": "map"}, "pose": {"position": {"x": x}, "orientation": {"w": 1.0}}}


def place(message: dict[str, Any]) -> tuple[str, float]:
    """Return frame and position of a stamped pose."""
    return message["header"]["frame_id"], message["pose"]["position"]["x"]


class Pair:
    """An action server on one side and a client on the other, both with the commands of `tests.peers.peer`."""

    def __init__(self, server: tuple[str, Any], client: tuple[str, Any]) -> None:
        self.sides = server[0], client[0]
        self.server, self.client = server[1], client[1]
        self._of = "_to_".join(name.split()[-1].split("'")[0].lower() for name in self.sides)

    def name(self, kind: str) -> str:
        """Return an action name that only this pair uses."""
        return f"/{self._of}/{kind}"

    def act(self, name: str, **more: Any) -> int:
        """Serve an action."""
        request = {"action": name, "type": self.type(0), "feedback": [self.feedback()], **more}
        return int(self.server.ask("act", **request)["id"])

    def send(self, name: str, **more: Any) -> int:
        """Send a goal."""
        request = {"action": name, "type": self.type(1), "goal": self.sent(), "seconds": SECONDS, **more}
        return int(self.client.ask("send_goal", **request)["id"])

    def goal(self, goal: int, **wanted: Any) -> dict[str, Any]:
        """Return the client's state of a goal, once the state has these values."""
        return self.goal_within(goal, SECONDS, **wanted)

    def goal_within(self, goal: int, seconds: float, **wanted: Any) -> dict[str, Any]:
        """Return the client's state of a goal, like `goal`, but with a given time limit."""
        result: dict[str, Any] = self.client.ask("goal", id=goal, until=wanted, seconds=seconds)
        seen = {k: len(result[k]) if k == "feedback" else result[k] for k in wanted}
        assert seen == wanted, f"{seen}, not {wanted}"
        return result

    # -- messages ------------------------------------------------------------------------------------------------------

    def type(self, end: int) -> str:
        """Return the action's type at the server (0) or at the client (1)."""
        return TYPES[self.sides[end]]

    def sent(self) -> dict[str, Any]:
        """Return the client's goal."""
        return {FIELDS[self.sides[1]][0]: pose(3.5)}

    def feedback(self) -> dict[str, Any]:
        """Return the server's feedback."""
        return {FIELDS[self.sides[0]][1]: pose(1.5)}

    def check(self, seen: dict[str, Any], heard: dict[str, Any]) -> None:
        """Check the goal that the server received, and the feedback that the client received."""
        assert place(seen[FIELDS[self.sides[0]][0]]) == ("map", 3.5)
        assert place(heard[FIELDS[self.sides[1]][1]]) == ("map", 1.5)

    # -- parts of an action --------------------------------------------------------------------------------------------

    def goal_and_result(self) -> None:
        """Send a goal, and check its feedback and its result."""
        acting = self.act(self.name("held"), held=True)
        goal = self.send(self.name("held"))
        answer = self.goal(goal, accepted=True, feedback=1)
        (seen,) = self.server.ask("goals", id=acting)["goals"]
        self.check(seen, answer["feedback"][0])
        self.server.ask("release", id=acting)
        assert self.goal(goal, status=SUCCEEDED)["result"] is not None

    def abort(self) -> None:
        """Send a goal that the server aborts."""
        self.act(self.name("abort"), outcome="abort")
        self.goal(self.send(self.name("abort")), accepted=True, status=ABORTED)

    def cancel(self) -> None:
        """Send a goal and cancel it."""
        self.act(self.name("cancel"), held=True)
        goal = self.send(self.name("cancel"))
        self.goal(goal, accepted=True, feedback=1)
        self.client.ask("cancel", id=goal)
        self.goal(goal, cancel=[0, 1], status=CANCELED)

    def reject(self) -> None:
        """Send a goal that the server rejects."""
        self.act(self.name("reject"), outcome="reject")
        self.goal(self.send(self.name("reject")), accepted=False, status=0)

    def parts(self) -> dict[str, Callable[[], None]]:
        """Return all checks by name."""
        return {
            "goal, feedback, result": self.goal_and_result,
            "abort": self.abort,
            "cancel": self.cancel,
            "reject": self.reject,
        }


class LookupPair(Pair):
    """A pair that uses ``tf2_msgs/LookupTransform``, whose feedback has no fields."""

    def type(self, end: int) -> str:  # noqa: ARG002
        return LOOKUP

    def sent(self) -> dict[str, Any]:
        return {"target_frame": "map"}

    def feedback(self) -> dict[str, Any]:
        return {}

    def check(self, seen: dict[str, Any], heard: dict[str, Any]) -> None:  # noqa: ARG002
        assert seen["target_frame"] == "map"


def table(deployment: Deployment) -> Iterator[Line]:
    """Start the daemon, and test every pair."""
    names = Address("127.0.0.1", free_port())
    rule = {"service": "/from_yarp", "port": YARP_RPC, "type": "std_srvs/srv/SetBool"}
    yarp = {"nameserver": "embedded", "address": f"{names.host}:{names.port}", "poll": 0.1, "services": [rule]}
    deployment.start(yarp=yarp, zenoh={"dialects": dialects()})
    for side in ("yarp", "zenoh_ros2dds", "zenoh_ros1", "zenoh_json"):
        until(lambda side=side: deployment.worker(side).get("state") == "running", f"{side} is joined", SECONDS)
    ros1, ros2 = deployment.ros1(), deployment.ros2()
    ports = deployment.keep(YarpServices(NameClient(names)))
    endpoint = f"tcp/127.0.0.1:{deployment.port}"
    texts = service_texts() | zenoh_actions.TEXTS
    ros2dds = deployment.keep(Ros2ddsBridge(endpoint, Messages(ros1=False, texts=texts)))
    sides: dict[str, ServiceSide] = {
        ROS1: RosServices(ros1),
        ROS2: RosServices(ros2),
        ZENOH: RosServices(deployment.sdk()),
        ROS2DDS: RosServices(ros2dds),
        ROS1_KEYS: RosServices(deployment.keep(Ros1Bridge(endpoint, Messages(ros1=True, texts=service_texts())))),
        JSON: JsonServices(deployment.keep(JsonProgram(endpoint))),
        YARP: ports,
    }
    yield from services(sides)
    hub = deployment.keep(HubActions(deployment.settings("module")))
    plugin = deployment.keep(Ros2ddsActions(ros2dds, SECONDS))
    yield from actions({ROS1: ros1, ROS2: ros2, HUB: hub, ROS2DDS: plugin})


def dialects() -> list[dict[str, Any]]:
    """Return the dialects' configuration, in which each JSON service is declared."""
    names = {f"/from_{key}": "in" if side == JSON else "out" for side, key in KEYS.items()}
    keys = [
        {"key": f"json{name}", "topic": name, "type": "std_srvs/srv/SetBool", "direction": direction}
        for name, direction in names.items()
    ]
    return [{"dialect": "ros2dds"}, {"dialect": "ros1"}, {"dialect": "json", "keys": keys}]


def services(sides: dict[str, ServiceSide]) -> Iterator[Line]:
    """Let each side serve one service, which all other sides call."""
    for server, side in sides.items():
        side.serve(f"/from_{KEYS[server]}", f"by {server}")
    for server in sides:
        for client, side in sides.items():
            if client != server:
                service = f"/from_{KEYS[server]}"
                yield line("service", server, client, {"request, reply": partial(ask, side, service, server)})


def ask(side: ServiceSide, service: str, server: str) -> None:
    """Call a service until it is discovered, and check that the reply is that of its server."""
    end = time.monotonic() + SECONDS
    while True:
        reply: object = "no server"
        try:
            reply = side.call(service, data=True)
        except (AssertionError, OSError) as err:
            reply = err
        if reply == {"success": True, "message": f"by {server}"}:
            return
        assert time.monotonic() < end, f"{service}: {reply!r}"
        time.sleep(0.1)


def actions(peers: dict[str, Any]) -> Iterator[Line]:
    """Let each side send goals to the servers of all others."""
    for server in peers.items():
        for client in peers.items():
            if client[0] != server[0]:
                pair = LookupPair if ROS2DDS in (client[0], server[0]) else Pair
                yield line("action", server[0], client[0], pair(server, client).parts())


def line(kind: str, server: str, client: str, parts: dict[str, Callable[[], None]]) -> Line:
    """Test all parts between two sides."""
    began = time.monotonic()
    passed, failed = [], []
    for name, part in parts.items():
        try:
            part()
            passed.append(name)
        except AssertionError as err:
            failed.append(f"{name}: {err}")
    return Line(kind, server, client, ", ".join(passed), "; ".join(failed), time.monotonic() - began)


def text(lines: list[Line]) -> str:
    """Return the table as text."""
    rows = [("kind", "server", "client", "crossed", "seconds", "failed")]
    rows += [(n.kind, n.server, n.client, n.passed, f"{n.seconds:.2f}", n.failed) for n in lines]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def main() -> int:
    """Print the table; return 1 if anything did not cross."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the table to this file")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, Deployment(Path(folder)) as deployment:
        lines = list(table(deployment))
    print(text(lines))
    if args.json:
        args.json.write_text(json.dumps([asdict(item) for item in lines], indent=2) + "\n")
    return int(not all(item.good for item in lines))


if __name__ == "__main__":
    sys.exit(main())
