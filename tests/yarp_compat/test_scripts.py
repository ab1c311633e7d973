"""Unchanged scripts for the official Python bindings (`import yarp`) run on `yarp_compat`, as separate programs."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

import yarp_compat as yarp
from tests.peers.yarp.script import SCRIPTS, output_lines, start
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming.server import NameServer

OUTPUTS = {
    "ports": """
        read item 0 0.0 ([set] 1000000000000)
        read item 1 0.25 ([set] 1000000000000)
        read item 2 0.5 ([set] 1000000000000)
        read end
        outputs 1 inputs 1
        connected False
    """,
    "strict_reading": """
        newest 49 pending 0
        nothing None
        strict True last 49
    """,
    "processor": """
        from /processor/client came 1 two 3.5
        answered received 1 two 3.5
        from /processor/client came no answer needed
        closing
    """,
    "callbacks": """
        /callbacks/vectors:i 3 1.5
        matrix 2x2 4.0
    """,
    "images": """
        received 65 48 200 3
        red at [20, 10] blue 7
        inverted 0 255 248 255
        others 32 2.5
    """,
    "properties": r"""
        r1 2 0.16
        True False True
        /laser 0.100000000000000005551 30.0
        False
        cer 0.02 True
        7 True 1 True
        42 True hello 42 3.5 [set] (a (b 1)) "two words" {1 2 255}
        same True 42 True 6
        stop set
        True 1.5 True 0
    """,
    "envelopes": """
        0.0 True 0 100.0 True
        1.0 True 1 100.125 True
        2.0 True 2 100.25 True
        True any bottle (is an envelope)
    """,
    "network_tools": """
        server True /root
        where /tools/one tcp True True
        exists True False True
        connect True True
        again True 1
        missing False
        property True
        color red
        admin True "/tools/two"
        gone False False
    """,
    "children": """
        [6, 9]
    """,
    "topics": """
        /chatter+@/yarp/talker /chatter-@/yarp/listener
        received: Hello from YARP
    """,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Run a name server, and yield the folder with its yarp.conf."""
    config = tmp_path_factory.mktemp("yarp")
    with NameServer(port=free_port()) as server:
        (config / "yarp.conf").write_text(f"{server.address.host} {server.address.port} yarp\n")
        yield config


def lines(text: str) -> list[str]:
    return [line.strip() for line in text.strip().splitlines()]


@pytest.mark.parametrize("script", OUTPUTS)
def test_a_script_prints_the_same_as_on_yarp(folder: Path, script: str) -> None:
    assert output_lines(start(script, folder)) == lines(OUTPUTS[script])


def test_one_program_prints_the_messages_of_another(folder: Path) -> None:
    sender = start("send_bottles", folder, "/send/bottles:o", "20")
    printer = start("print_bottles", folder, "/send/bottles:o", "20")
    assert output_lines(printer) == [f"/print/bottles:i: number {i}" for i in range(20)]
    assert output_lines(sender) == []


def test_one_program_replies_to_another(folder: Path) -> None:
    server = start("rpc_server", folder, "/rpc/server")
    client = start("rpc_client", folder, "/rpc/server")
    assert output_lines(client) == [
        "sum 1 2.5 3 -> True 6.5",
        "reverse a b c -> True (c b a)",
        "dance fast -> True unknown dance fast",
        "stop -> True [ok]",
    ]
    assert output_lines(server) == []


def test_resources_are_found(folder: Path, tmp_path: Path) -> None:
    context = tmp_path / "contexts" / "kitchen"
    context.mkdir(parents=True)
    (context / "robot.ini").write_text("robot cer\nspeed 0.5\nmap plan.txt\n[LASER]\nport /laser\nrange (0.1 30.0)\n")
    (context / "plan.txt").touch()
    program = start(
        "resources", folder, "--speed", "0.75", YARP_DATA_DIRS=str(tmp_path), YARP_DATA_HOME=str(tmp_path / "own")
    )
    assert output_lines(program) == [
        "robot cer",
        "period 0.1",
        "speed 0.75",
        "laser /laser 0.100000000000000005551 30.0",
        "sonar True",
        f"map {context / 'plan.txt'}",
        "absent ''",
        f"home {tmp_path / 'own' / 'contexts' / 'kitchen'}",
    ]


@pytest.mark.parametrize("end", ["quit", "signal"])
def test_a_module_runs_and_stops(folder: Path, monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    module = start("module", folder, "--name", f"/{end}", "--step", "2", "--period", "0.01")
    monkeypatch.setenv("YARP_CONFIG_HOME", str(folder))
    rpc, reply = f"/{end}/rpc", yarp.Bottle()
    with yarp.Network():
        assert yarp.Network.waitPort(rpc, True)

        def runs() -> bool:
            """Return whether the first cycle has run, before which the module does not handle signals."""
            assert yarp.Network.write(rpc, yarp.Bottle("total"), reply)
            assert reply.get(0).asInt32() % 2 == 0
            return reply.get(0).asInt32() > 0

        until(runs, "the module runs")
        assert yarp.Network.write(rpc, yarp.Bottle("step 4"), reply)
        assert reply.toString() == "ok"
        if end == "quit":
            assert yarp.Network.write(rpc, yarp.Bottle("[quit]"), reply)
            assert reply.toString() == "[bye]"
        else:
            module.send_signal(signal.SIGTERM)
    assert output_lines(module) == ["configured", "interrupted", "closed"]


def test_every_script_is_tested() -> None:
    others = {"send_bottles", "print_bottles", "rpc_server", "rpc_client", "resources", "module"}
    with_a_daemon = {"ros_topics"}  # tests/adapters/yarp/test_script.py
    with_devices = {"navigate", "robot_parts"}  # tests/yarp_compat/test_device_scripts.py
    assert {path.stem for path in SCRIPTS.glob("*.py")} == {*OUTPUTS, *others, *with_a_daemon, *with_devices}
