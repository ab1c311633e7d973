"""An external listener without TLS: machines have no names, so others may send commands only if all are trusted."""

from __future__ import annotations

import json
import os
import sys
from typing import Any

import pytest

from tests.peers.hub.network import ROOT, ROUTER_PROGRAM
from tests.support.netns import Cable, Machine, need_namespaces
from tests.support.wait import until

PROGRAM = """
import json, sys, time, zenoh
from bridge.hub.zenoh_config import make_config, session_tree
place, keys, seconds = sys.argv[1], json.loads(sys.argv[2]), float(sys.argv[3])
tree = session_tree(place, shared_memory=False, max_payload=1 << 20)
received = []
with zenoh.open(make_config(tree, {"mode": "client"})) as session:
    session.declare_subscriber(
        "**", lambda sample: received.append(str(sample.key_expr)), allowed_origin=zenoh.Locality.REMOTE
    )
    print("joined", flush=True)
    end = time.monotonic() + seconds
    while time.monotonic() < end and received.count("0/end/std_msgs::msg::dds_::String_/RIHS01_ab") < 2:
        for key in keys:
            session.put(key, b"go")
        time.sleep(0.1)
print(json.dumps(received))
"""
COMMAND = "0/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_ab"
DATA = "0/odom/nav_msgs::msg::dds_::Odometry_/RIHS01_ab"
END = "0/end/std_msgs::msg::dds_::String_/RIHS01_ab"


@pytest.mark.parametrize(("trusted", "expected"), [([], {DATA, END}), (["*"], {COMMAND, "0/**", DATA, END})])
def test_commands_without_tls_are_delivered_only_if_all_machines_are_trusted(
    trusted: list[str], expected: set[str]
) -> None:
    need_namespaces()
    robot, other = Machine("open-robot"), Machine("open-other")
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    started: list[Any] = []
    try:
        cable = Cable(robot, other, 79)
        opened = {"listen": ["tcp/0.0.0.0:7448"], "insecure": True, "trusted": trusted}
        config = json.dumps({"name": "robot", "hub": {"router": True, "open": opened}})
        started.append(robot.start(sys.executable, ROUTER_PROGRAM, config, env=env))
        until(lambda: "listening" in started[0].output(), "the router listens")
        local = robot.start(sys.executable, "-c", PROGRAM, "tcp/127.0.0.1:7447", "[]", "60", env=env)
        started.append(local)
        until(lambda: "joined" in local.output(), "a local program joins")
        key_exprs = json.dumps([COMMAND, "0/**", DATA, END])
        place = f"tcp/{cable.addresses[0]}:7448"
        started.append(other.start(sys.executable, "-c", PROGRAM, place, key_exprs, "60", env=env))
        local.popen.wait(90)
        assert set(json.loads(local.output().splitlines()[-1])) == expected
    finally:
        for process in reversed(started):
            process.stop()
        robot.close()
        other.close()
