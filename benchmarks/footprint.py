"""Midspan's footprint on a small computer: memory, processor time and start-up of each worker and of bare peers.

Five parts, selected by `--parts`:

- `start`: each worker, started as by the daemon, compared with an interpreter with only rospy, rclpy or a zenoh session
  and one subscriber: seconds to the first heartbeat and until it runs, processor time until then.
- `robot`: `midspan run` with all sides and the demo's robot at rest: memory of each process compared with the
  project's aims and the bare peers, seconds until all sides run, processor time.
- `idle`: as `robot`, without a robot, with the zenoh side: idle processor time, compared with bare zenoh sessions that
  are configured and joined like the hub's, and idle ROS 1 and ROS 2 programs. The difference is what could be saved.
- `metrics`: the cost of metrics at rest, without scrapes and with one every five seconds, compared with no metrics.
- `cli`: seconds of the command line's verbs, with the robot's daemon.

File caches are warm, and bytecode is compiled.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import statistics
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.footprints.measured import ProcessUsage, cpu_seconds, process_usage
from benchmarks.footprints.worker import StartedWorker
from benchmarks.latency.usage import daemon_processes
from benchmarks.processes import Processes
from benchmarks.rows import Row, add_json_option, report
from bridge.client.errors import ClientError
from bridge.client.session import connect
from bridge.client.status import answered
from bridge.demo.rooms import CONFIG, overrides
from bridge.state_file import with_state
from tests.support.ports import free_port

PEERS = {"router": "zenoh", "ros1": "ros1", "ros2": "ros2", "yarp": "zenoh", "modules": "zenoh", "sim": "zenoh"}
"""The bare peer of each worker. It is a zenoh session for modules, simulator and YARP, which has no Python library."""
AIMS = {"router": 30.0, "ros1": 45.0, "ros2": 120.0, "yarp": 50.0, "modules": 80.0, "sim": 80.0, "daemon": 25.0}
"""Aims for PSS, MB."""
IDLE, STANDING, RUN, HELP, VERB = 1.0, 25.0, 3.0, 0.25, 0.8
"""Aims: percent of a core while idle and with the robot at rest; seconds of `midspan run`, `midspan --help`, a verb."""
SIDES = ("ros1", "ros2", "yarp")
DRIVER = "robot_goto"
"""The module that becomes ready last, because it waits for the simulator's laser."""
VERBS = ("--help", "status", "topic list", "nav status", "tf tree")
SETTLE_SECONDS = 10.0
"""Seconds after which compilation, connections and discovery of a start-up are complete."""
_UP_SECONDS = 60.0
PARTS = ("start", "robot", "idle", "metrics", "cli")
SCRAPE_SECONDS = 5.0


def _overrides() -> dict[str, Any]:
    """Return the demo's overrides without the console, because the aims are for bridging and driving."""
    return {**overrides(CONFIG), "web": {"enabled": False}}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="duration of each measurement at rest, seconds (default 60)"
    )
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="parts to run (default all)")
    parser.add_argument("--times", type=int, default=5, metavar="N", help="runs of each verb (default 5)")
    add_json_option(parser)
    args = parser.parse_args(arguments)
    rows: list[Row] = []
    with Processes(_overrides(), CONFIG, yarp=True) as bare:
        bare.start_master()
        peers, peer_seconds = _peers(bare)
        if "start" in args.parts:
            rows += _start(bare, peers, peer_seconds)
        idle_floor = _idle_floor(bare, args.seconds) if "idle" in args.parts else 0.0
    if "robot" in args.parts or "cli" in args.parts:
        with _daemon(Processes(_overrides(), CONFIG, yarp=True), (*SIDES, DRIVER)) as (robot, seconds):
            if "robot" in args.parts:
                rows += [*seconds, *_robot(robot, peers, args.seconds)]
            if "cli" in args.parts:
                rows += _verbs(robot, args.times)
    if "idle" in args.parts:
        dialects = {"zenoh": {"dialects": [{"dialect": "ros2dds"}]}, "modules": {"enabled": False}}
        with _daemon(Processes(dialects, yarp=True), (*SIDES, "zenoh_ros2dds")) as (idle, seconds):
            rows += [*seconds, *_at_rest("idle", idle, args.seconds, IDLE)]
            rows.append(replace(rows[-1], case="idle: all, bare sessions", peer=idle_floor))
    if "metrics" in args.parts:
        rows += _metrics(peers, args.seconds)
    report(rows, args.json)
    return 0


def _metrics(peers: dict[str, ProcessUsage], seconds: float) -> list[Row]:
    """Measure the daemon without metrics, with metrics, and with scrapes."""
    modules = {"modules": {"enabled": False}}
    address = f"127.0.0.1:{free_port()}"
    with _daemon(Processes(modules, yarp=True), SIDES) as (place, _):
        without = _at_rest("without metrics", place, seconds, IDLE)[-1]
    with _daemon(Processes({**modules, "metrics": {"enabled": True, "listen": address}}, yarp=True), SIDES) as (
        place,
        _,
    ):
        usage = process_usage(daemon_processes(place.place.folder)["metrics"])
        quiet = _at_rest("metrics, not scraped", place, seconds, IDLE)[-1]
        stop = threading.Event()
        scraper = threading.Thread(target=_scrape, args=(f"http://{address}/metrics", stop))
        scraper.start()
        scraped = _at_rest("metrics, scraped each 5 s", place, seconds, IDLE)[-1]
        stop.set()
        scraper.join()
    return [
        Row("metrics: PSS, bare zenoh", usage.pss, peers["zenoh"].pss, "MB"),
        without,
        *(replace(row, peer=without.ours) for row in (quiet, scraped)),
    ]


def _scrape(url: str, stop: threading.Event) -> None:
    while not stop.wait(SCRAPE_SECONDS):
        with urllib.request.urlopen(url, timeout=SCRAPE_SECONDS) as answer:
            answer.read()


def _peers(place: Processes) -> tuple[dict[str, ProcessUsage], dict[str, float]]:
    """Measure the bare peers and their start-up, in seconds."""
    children, seconds = {}, {}
    for kind in ("ros1", "ros2", "zenoh"):
        began = time.monotonic()
        children[kind] = place.launch(kind, "benchmarks.footprints.peer", kind, system=kind == "ros1")
        place.wait_for(kind, "ready")
        seconds[kind] = time.monotonic() - began
    usage = {kind: process_usage(child.pid) for kind, child in children.items()}
    for kind in children:
        place.stop(kind)
    return usage, seconds


def _idle_floor(place: Processes, seconds: float) -> float:
    """Return the percentage of a core of a router, four sessions like the workers', and an idle program of each ROS."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    kinds = {"router": "router", **{f"hub{number}": "hub" for number in range(4)}, "ros1": "ros1", "ros2": "ros2"}
    children = {}
    for name, kind in kinds.items():
        arguments = (kind, endpoint) if kind in ("router", "hub") else (kind,)
        children[name] = place.launch(name, "benchmarks.footprints.peer", *arguments, system=kind == "ros1")
        place.wait_for(name, "ready")
    time.sleep(SETTLE_SECONDS)
    before = {name: cpu_seconds(child.pid) for name, child in children.items()}
    began = time.monotonic()
    time.sleep(seconds)
    passed = time.monotonic() - began
    share = 100.0 * sum(cpu_seconds(child.pid) - before[name] for name, child in children.items()) / passed
    for name in children:
        place.stop(name)
    return share


def _start(place: Processes, peers: dict[str, ProcessUsage], peer_seconds: dict[str, float]) -> list[Row]:
    """Start the workers one after the other; each thus starts while others run, as if it were restarted."""
    config, environ, rows = with_state(place.place.config), place.place.environment(), []
    with contextlib.ExitStack() as stack:
        for name, kind in PEERS.items():
            started = stack.enter_context(StartedWorker(name, config, environ))
            started.wait()
            rows += [
                Row(f"{name}: first heartbeat", started.first, peer_seconds[kind], "s"),
                Row(f"{name}: running", started.running, peer_seconds[kind], "s"),
                Row(f"{name}: processor time", started.cpu, peers[kind].seconds, "s"),
            ]
    return rows


@contextlib.contextmanager
def _daemon(place: Processes, sides: Sequence[str]) -> Iterator[tuple[Processes, list[Row]]]:
    """Start a daemon, and wait until all sides run and its load has settled; yields the rows of its start-up."""
    with place:
        place.start_master()
        began = time.monotonic()
        place.start_daemon()
        times: dict[str, float] = {}

        def all_run() -> bool:
            with contextlib.suppress(ClientError), connect(place.place.config, 0.2) as client:
                while len(times) < len(sides):
                    for status in answered(client, 0.5):
                        if status.state == "running" and status.worker in sides:
                            times.setdefault(status.worker, time.monotonic() - began)
                    time.sleep(0.05)
                    if time.monotonic() - began > _UP_SECONDS:
                        break
            return len(times) == len(sides)

        place.until(all_run, f"{', '.join(sides)} run")
        time.sleep(SETTLE_SECONDS)
        load = "the robot" if DRIVER in sides else "no robot"
        rows = [Row(f"midspan run, {load}: all sides running", max(times[s] for s in SIDES), RUN, "s")]
        yield place, rows


def _robot(place: Processes, peers: dict[str, ProcessUsage], seconds: float) -> list[Row]:
    usage = {name: process_usage(pid) for name, pid in daemon_processes(place.place.folder).items()}
    rows = [Row(f"{name}: PSS, aim", usage[name].pss, aim, "MB") for name, aim in AIMS.items()]
    for name, kind in PEERS.items():
        rows.append(Row(f"{name}: PSS, bare {kind}", usage[name].pss, peers[kind].pss, "MB"))
        rows.append(Row(f"{name}: RSS, bare {kind}", usage[name].rss, peers[kind].rss, "MB"))
    rows.append(Row("all: PSS, aims", sum(t.pss for t in usage.values()), sum(AIMS.values()), "MB"))
    return rows + _at_rest("standing", place, seconds, STANDING)


def _at_rest(what: str, place: Processes, seconds: float, aim: float) -> list[Row]:
    """Measure each process at rest, and all together, in percent of a core."""
    pids = daemon_processes(place.place.folder)
    before = {name: cpu_seconds(pid) for name, pid in pids.items()}
    began = time.monotonic()
    time.sleep(seconds)
    passed = time.monotonic() - began
    shares = {name: 100.0 * (cpu_seconds(pid) - before[name]) / passed for name, pid in pids.items()}
    rows = [Row(f"{what}: {name}", share, aim, "%") for name, share in shares.items()]
    return [*rows, Row(f"{what}: all", sum(shares.values()), aim, "%")]


def _verbs(place: Processes, times: int) -> list[Row]:
    rows = []
    for verb in VERBS:
        config = [] if verb.startswith("-") else ["--config", str(place.place.config_file)]
        command = [sys.executable, "-m", "bridge.cli.main", *verb.split(), *config]
        durations: list[float] = []
        for _ in range(3 * times):  # the first run warms the caches; failed runs on a busy machine do not count
            began = time.monotonic()
            ended = subprocess.run(command, env=place.place.environment(), stdout=subprocess.DEVNULL, check=False)
            if ended.returncode == 0:
                durations.append(time.monotonic() - began)
            if len(durations) > times:
                break
        rows.append(
            Row(f"midspan {verb}", statistics.median(durations[1:] or [math.inf]), HELP if config == [] else VERB, "s")
        )
    return rows


if __name__ == "__main__":
    sys.exit(main())
