"""Scripts for the official Python bindings, unchanged (`import yarp`), on ours: each a program with its own output."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import yarp_compat as yarp
from tests.support.ports import free_port
from yarp_compat.naming.server import NameServer

SCRIPTS = Path(__file__).parent / "scripts"

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
        colour red
        admin True "/tools/two"
        gone False False
    """,
    "topics": """
        /chatter+@/yarp/talker /chatter-@/yarp/listener
        received: Hello from YARP
    """,
}


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """A name server, and the variables with which programs find it."""
    folder = tmp_path_factory.mktemp("yarp")
    with NameServer(port=free_port()) as server:
        (folder / "yarp.conf").write_text(f"{server.address.host} {server.address.port} yarp\n")
        yield {name: value for name, value in os.environ.items() if not name.startswith("YARP_")} | {
            "YARP_CONFIG_HOME": str(folder),
            "YARP_DATA_HOME": str(folder / "data"),
            "YARP_DATA_DIRS": str(folder / "installed"),
        }


def start(environment: dict[str, str], script: str, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "yarp_compat", str(SCRIPTS / f"{script}.py"), *words],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=environment["YARP_CONFIG_HOME"],
    )  # fmt: skip


def output(program: subprocess.Popen[str]) -> list[str]:
    """What a program printed itself, at its end; the library's own lines begin with their level."""
    try:
        out, err = program.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        program.kill()
        out, err = program.communicate()
    assert program.returncode == 0, f"{out}\n{err}"
    return [line for line in out.splitlines() if not line.startswith("[")]


def lines(text: str) -> list[str]:
    return [line.strip() for line in text.strip().splitlines()]


@pytest.mark.parametrize("script", OUTPUTS)
def test_a_script_does_what_it_does_on_yarp(environment: dict[str, str], script: str) -> None:
    assert output(start(environment, script)) == lines(OUTPUTS[script])


def test_a_program_sends_and_another_prints(environment: dict[str, str]) -> None:
    sender = start(environment, "send_bottles", "/send/bottles:o", "20")
    printer = start(environment, "print_bottles", "/send/bottles:o", "20")
    assert output(printer) == [f"/print/bottles:i: number {i}" for i in range(20)]
    assert output(sender) == []


def test_a_program_asks_and_another_answers(environment: dict[str, str]) -> None:
    server = start(environment, "rpc_server", "/rpc/server")
    client = start(environment, "rpc_client", "/rpc/server")
    assert output(client) == [
        "sum 1 2.5 3 -> True 6.5",
        "reverse a b c -> True (c b a)",
        "dance fast -> True unknown dance fast",
        "stop -> True [ok]",
    ]
    assert output(server) == []


def test_resources_are_found(environment: dict[str, str], tmp_path: Path) -> None:
    context = tmp_path / "contexts" / "kitchen"
    context.mkdir(parents=True)
    (context / "robot.ini").write_text("robot cer\nspeed 0.5\nmap plan.txt\n[LASER]\nport /laser\nrange (0.1 30.0)\n")
    (context / "plan.txt").touch()
    found = start(environment | {"YARP_DATA_DIRS": str(tmp_path)}, "resources", "--speed", "0.75")
    assert output(found) == [
        "robot cer",
        "period 0.1",
        "speed 0.75",
        "laser /laser 0.100000000000000005551 30.0",
        "sonar True",
        f"map {context / 'plan.txt'}",
        "absent ''",
        f"home {environment['YARP_DATA_HOME']}/contexts/kitchen",
    ]


@pytest.mark.parametrize("end", ["quit", "signal"])
def test_a_module_runs_and_stops(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    module = start(environment, "module", "--name", f"/{end}", "--step", "2", "--period", "0.01")
    monkeypatch.setenv("YARP_CONFIG_HOME", environment["YARP_CONFIG_HOME"])
    rpc, reply = f"/{end}/rpc", yarp.Bottle()
    with yarp.Network():
        assert yarp.Network.waitPort(rpc, True)
        assert yarp.Network.write(rpc, yarp.Bottle("total"), reply)
        assert reply.get(0).asInt32() % 2 == 0
        assert yarp.Network.write(rpc, yarp.Bottle("step 4"), reply)
        assert reply.toString() == "ok"
        if end == "quit":
            assert yarp.Network.write(rpc, yarp.Bottle("[quit]"), reply)
            assert reply.toString() == "[bye]"
        else:
            module.send_signal(signal.SIGTERM)
    assert output(module) == ["configured", "interrupted", "closed"]


def test_every_script_is_run() -> None:
    others = {"send_bottles", "print_bottles", "rpc_server", "rpc_client", "resources", "module"}
    with_a_daemon = {"ros_topics"}  # tests/adapters/yarp/test_script.py
    assert {path.stem for path in SCRIPTS.glob("*.py")} == {*OUTPUTS, *others, *with_a_daemon}
