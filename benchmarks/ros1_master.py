"""Registrations and calls per second of the embedded ROS 1 master, and of the real rosmaster.

Each runs in a separate process. Clients are in this process, one or eight at a time, with persistent connections as
nodes have. Each call registers another topic of its node, or sets a parameter.
"""

from __future__ import annotations

import argparse
import http.client
import subprocess
import sys
import tempfile
import time
import xmlrpc.client
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from tests.peers.ros1.network import ROS1_PYTHON, ros1_environment
from tests.support.ports import free_port
from tests.support.wait import until

OWN = (
    "import sys, threading; from pathlib import Path; from bridge.adapters.ros1.master.embedded import EmbeddedMaster;"
    " EmbeddedMaster('127.0.0.1', int(sys.argv[1]), state=Path(sys.argv[2]), purge=30).start();"
    " threading.Event().wait()"
)
TARGET = 1000.0
"""Registrations per second that the project wants."""


@contextmanager
def running(*, own: bool) -> Iterator[int]:
    """Run a master; yield its port."""
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        env = {**ros1_environment(), "ROS_LOG_DIR": folder, "ROS_HOME": folder}
        command = [str(ROS1_PYTHON), "/usr/bin/rosmaster", "--core", "-p", str(port)]
        if own:
            env["PYTHONPATH"] = str(Path(__file__).parents[1])
            command = [sys.executable, "-c", OWN, str(port), f"{folder}/state.json"]
        process = subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            until(lambda: answers(port), "the master answers")
            yield port
        finally:
            process.terminate()
            process.wait()


def answers(port: int) -> bool:
    """Return whether a master replies."""
    try:
        with xmlrpc.client.ServerProxy(f"http://127.0.0.1:{port}/") as proxy:
            return bool(proxy.getPid("/benchmark"))
    except OSError:
        return False


def rate(port: int, method: str, clients: int, count: int) -> float:
    """Return the calls per second of several clients together."""

    def run(client: int) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        node, api = f"/{method}{clients}_{client}", f"http://127.0.0.1:{client + 1}/"
        for number in range(count // clients):
            rest = (
                (f"{node}/p{number}", number) if method == "setParam" else (f"{node}/t{number}", "std_msgs/String", api)
            )
            connection.request("POST", "/", xmlrpc.client.dumps((node, *rest), method))
            connection.getresponse().read()
        connection.close()

    began = time.perf_counter()
    with ThreadPoolExecutor(clients) as pool:
        list(pool.map(run, range(clients)))
    return count // clients * clients / (time.perf_counter() - began)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000, metavar="N", help="calls per case (default 2000)")
    add_json_option(parser)
    args = parser.parse_args(argv)
    rates: dict[tuple[bool, str, int], float] = {}
    for own in (True, False):
        with running(own=own) as port:
            for method in ("registerPublisher", "setParam"):
                for clients in (1, 8):
                    rates[own, method, clients] = rate(port, method, clients, args.count)
    cases = [key[1:] for key in rates if key[0]]
    rows = [
        Row(f"{method}, {clients} clients", rates[True, method, clients], rates[False, method, clients], "1/s", "more")
        for method, clients in cases
    ]
    target = rates[True, "registerPublisher", 1]
    report([*rows, Row("registerPublisher against the aim", target, TARGET, "1/s", "more")], args.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
