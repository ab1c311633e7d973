"""The cost of one robot's navigation: each process's share of a core, idle and driving, with a laser at 10 Hz.

The whole deployment runs: `midspan run` with simulator, base control, localizer, RobotGoto, RobotPathPlanner and
gateway. The "peer" of a row is the limit of its process, such as 40 % of a core for all modules. ``--tables`` runs
configs/tables.yaml, with a depth camera of 640 x 480 at 5 Hz, whose points RobotGoto receives. It runs without Mapper3D
and with it; the difference is the cost of mapping.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import psutil
import yaml

from benchmarks.rows import Row, add_json_option, report
from tests.peers.navigation.chain import Chain

_ENOUGH = {"modules": 40.0, "sim": 25.0, "yarp": 10.0, "router": 5.0, "daemon": 2.0}
"""Limits, percent of a core."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", action="store_true", help="with a depth camera, without Mapper3D and with it")
    parser.add_argument("--seconds", type=float, default=10.0, help="seconds of each measurement (default 10)")
    add_json_option(parser)
    args = parser.parse_args(arguments)
    if args.tables:
        rows = _measured("sideboard", args.seconds, "no mapping, ", **_tables(mapping=False))
        rows += _measured("sideboard", args.seconds, "mapping, ", **_tables(mapping=True))
    else:
        rows = _measured("kitchen", args.seconds)
    report(rows, args.json)
    return 0


def _tables(*, mapping: bool) -> dict[str, Any]:
    config: dict[str, Any] = yaml.safe_load((Path(__file__).parents[1] / "configs" / "tables.yaml").read_text())
    modules = config["modules"]
    if not mapping:
        del modules["mapper3d"], modules["robot_path_planner"]["obstacles"]
    return {"sim": config["sim"], "modules": modules}


def _measured(place: str, seconds: float, case: str = "", **sections: Any) -> list[Row]:
    with tempfile.TemporaryDirectory(prefix="midspan-nav-cost-") as folder, Chain(Path(folder), **sections) as chain:
        chain.start()
        chain.until(lambda: chain.truth is not None, "the true pose is published")
        time.sleep(3.0)  # until compilation and connections of the start are complete
        rows = _rows(f"{case}idle", _shares(chain, seconds))
        chain.goto(place)
        chain.until_moving()
        return rows + _rows(f"{case}driving", _shares(chain, seconds))


def _rows(what: str, shares: dict[str, float]) -> list[Row]:
    return [Row(f"{what}: {name}", share, _ENOUGH[name], "%") for name, share in shares.items()]


def _shares(chain: Chain, seconds: float) -> dict[str, float]:
    """Return each process's load, in percent of a core."""
    assert chain.daemon is not None
    daemon = psutil.Process(chain.daemon.pid)
    processes = {"daemon": daemon}
    for child in daemon.children(recursive=True):
        processes |= {name: child for name in _ENOUGH if name in child.cmdline()}
    before = {name: _spent(process) for name, process in processes.items()}
    began = time.monotonic()
    time.sleep(seconds)
    passed = time.monotonic() - began
    return {name: 100.0 * (_spent(process) - before[name]) / passed for name, process in processes.items()}


def _spent(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


if __name__ == "__main__":
    sys.exit(main())
