"""Ctrl-C ends each command that waits for a lock, also on Windows.

There a signal does not end the wait, and Python handles it only afterwards. Here SIGINT arrives at a thread that does
not wait for the lock, which has the same effect.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.peers.daemon.workers import config_file
from tests.peers.hub.quick import QuickHub
from tests.peers.yarp.programs import Names
from tests.support.hidden import as_on
from tests.support.ports import free_port
from tests.support.wait import SLOWNESS

START = """
import os, signal, sys, threading, time

def interrupt():
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    sys.stdin.readline()
    main = threading.main_thread().ident
    while sys._current_frames()[main].f_code.co_filename != threading.__file__:
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGINT)
    threading.Event().wait()

threading.Thread(target=interrupt, daemon=True).start()
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
"""
COMMAND = START + "from bridge.cli.main import main; sys.exit(main(sys.argv[1:]))"
READ = """
import yarp_compat as yarp
yarp.Network.init()
port = yarp.BufferedPortBottle()
port.open("/reads")
try:
    print("waits", flush=True)
    port.read()
except KeyboardInterrupt:
    os._exit(130)
"""
JOIN = """
import yarp_compat as yarp

class Waits(yarp.Thread):
    def run(self):
        threading.Event().wait()

waits = Waits()
waits.start()
try:
    print("waits", flush=True)
    waits.join()
except KeyboardInterrupt:
    os._exit(130)
"""


def interrupted(code: str, *arguments: str, until: str, folder: Path) -> int:
    """Run a program as on Windows, interrupt its next wait after it has printed ``until``; return its exit code."""
    env = as_on("windows") | {"PYTHONUNBUFFERED": "1", "YARP_CONFIG_HOME": str(folder)}
    command = [sys.executable, "-c", code, *arguments]
    with subprocess.Popen(
        command, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as program:
        assert program.stdin is not None
        assert program.stdout is not None
        try:
            seen = ""
            while until not in seen:
                line = program.stdout.readline()
                assert line, seen
                seen += line
            program.stdin.write("\n")
            program.stdin.flush()
            return program.wait(40 * SLOWNESS)
        finally:
            program.kill()


def test_ctrl_c_ends_the_publication_of_a_latched_message(tmp_path: Path) -> None:
    hub = QuickHub()
    try:
        config = config_file(tmp_path, hub)
        words = ["topic", "pub", "/word", "std_msgs/String", "--latch", "--settle", "0", "--config", str(config)]
        assert interrupted(COMMAND, *words, until="published", folder=tmp_path) == 0
    finally:
        hub.stop_router()


def test_ctrl_c_ends_a_name_server(tmp_path: Path) -> None:
    words = ["yarp", "server", "--port", str(free_port()), "--forget"]
    assert interrupted(COMMAND, *words, until="web page", folder=tmp_path) == 0


def test_ctrl_c_ends_the_read_of_a_port(tmp_path: Path) -> None:
    names = Names()
    try:
        (tmp_path / "yarp.conf").write_text(f"{names.endpoint.replace(':', ' ')} yarp\n")
        assert interrupted(COMMAND, "yarp", "read", "/reads", until="is open", folder=tmp_path) == 0
        assert interrupted(START + READ, until="waits", folder=tmp_path) == 130
    finally:
        names.stop()


def test_ctrl_c_ends_the_join_of_a_thread(tmp_path: Path) -> None:
    assert interrupted(START + JOIN, until="waits", folder=tmp_path) == 130
