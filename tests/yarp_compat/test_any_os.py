"""yarp_compat runs on any OS: tested in a process that hides everything that Windows lacks."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.hidden import HIDE
from tests.support.ports import free_port

ROOT = Path(__file__).parents[2]


def run(code: str, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", HIDE + code, *arguments],
        cwd=ROOT, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_hidden_functions_are_missing() -> None:
    assert run("print(hasattr(os, 'fork'), hasattr(socket, 'AF_UNIX'), hasattr(socket.socket(), 'sendmsg'))") == (
        "False False False\n"
    )


def test_every_module_can_be_imported() -> None:
    modules = sorted(
        ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for file in (ROOT / "yarp_compat").rglob("*.py")
        if file.name != "__main__.py"
    )
    assert len(modules) > 50
    code = """
import importlib, traceback
failed = []
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except Exception:
        failed.append(name)
        traceback.print_exc()
sys.exit(f"not imported: {failed}" if failed else 0)
"""
    run(code, *modules)


QUICK = "wire", "naming", "sig", "rosmsg", "dev", "ports"
NOT_THERE = (
    "ports/test_hostile.py::test_a_thousand_silent_connections_do_not_block_a_valid_peer",
    "dev/test_mapfiles.py::test_a_pipe_is_rejected",
    "ports/test_commands.py::test_a_stop_follows_the_commands_that_a_network_delays",
    "ports/test_commands.py::test_the_commands_of_a_silent_commander_are_followed_by_a_stop",
)
"""A test with more sockets than select supports on Windows (512), a test with a named pipe, and tests of what only
Linux shows."""


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_tests_of_yarp_compat_pass() -> None:
    folder = Path(__file__).parent.relative_to(ROOT)
    plugins = [
        argument for name in ("pytest_timeout", "xdist.plugin", "tests.support.any_os") for argument in ("-p", name)
    ]
    done = subprocess.run(
        [
            sys.executable, "-m", "pytest", *plugins, "-p", "no:cacheprovider", "-q", "--fast",
            "-m", "not thorough and not long and not alone", "-o", "timeout_method=thread",
            *(str(folder / name) for name in QUICK), *(f"--deselect={folder / name}" for name in NOT_THERE),
        ],
        cwd=ROOT, capture_output=True, text=True, timeout=800, check=False,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "HYPOTHESIS_NO_PLUGINS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr
    passed = re.search(r"([0-9]+) passed", done.stdout)
    assert passed, done.stdout[-500:]
    assert int(passed[1]) > 1000
    assert "skipped" not in done.stdout.splitlines()[-1]


TALK = """
import yarp_compat as yarp
from yarp_compat.naming.server import NameServer

folder, number = sys.argv[1], int(sys.argv[2])
os.environ["YARP_CONFIG_HOME"] = folder
with NameServer(port=number), open(os.path.join(folder, "yarp.conf"), "w") as file:
    file.write(f"127.0.0.1 {number} yarp\\n")
    file.close()
    yarp.Network.init()

    class Answer(yarp.PortReader):
        def read(self, connection):
            request = yarp.Bottle()
            if not request.read(connection):
                return False
            reply = yarp.Bottle()
            reply.addString("reply")
            reply.append(request)
            return reply.write(connection.getWriter())

    reader, server, client = Answer(), yarp.Port(), yarp.RpcClient()
    server.setReader(reader)
    assert server.open("/server") and client.open("/client")
    assert yarp.Network.connect("/client", "/server")
    request, reply = yarp.Bottle("ask 1 2.5"), yarp.Bottle()
    assert client.write(request, reply)
    print(reply.toString())

    source, sink = yarp.BufferedPortVector(), yarp.BufferedPortVector()
    assert source.open("/out") and sink.open("/in")
    for carrier in ("tcp", "fast_tcp", "udp"):
        assert yarp.Network.connect("/out", "/in", carrier)
        vector = source.prepare()
        vector.resize(3)
        vector[1] = 5.0
        source.writeStrict()
        print(carrier, sink.read(True).toString())
        assert yarp.Network.disconnect("/out", "/in")
    for port in (server, client, source, sink):
        port.close()
    yarp.Network.fini()
"""


def test_ports_exchange_messages_through_the_name_server(tmp_path: Path) -> None:
    printed = run(TALK, str(tmp_path), str(free_port()))
    lines = [line for line in printed.splitlines() if not line.startswith("[")]
    assert lines[0] == "reply ask 1 2.5"
    assert [line.split()[0] for line in lines[1:]] == ["tcp", "fast_tcp", "udp"]
    assert all("5.0" in line for line in lines[1:])
