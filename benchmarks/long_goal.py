"""A long goal with continuous feedback, in both directions: all feedback and the result must arrive.

Real actionlib and rclpy programs run on both ends of the whole daemon, in real time, in both directions at once.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from tests.peers.daemon.calls_table import ROS1, ROS2, SUCCEEDED, Pair
from tests.peers.daemon.deployment import Deployment

WAYS = {"ROS 2 client, ROS 1 server": (ROS1, ROS2), "ROS 1 client, ROS 2 server": (ROS2, ROS1)}
SLACK = 30.0  # seconds that a goal may take in addition to its duration


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 1 if a goal did not succeed, or feedback was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="duration of the goals (default 10)")
    parser.add_argument("--rate", type=float, default=10.0, help="feedback per second (default 10)")
    add_json_option(parser)
    args = parser.parse_args(arguments)
    count = round(args.minutes * 60 * args.rate)
    rows: list[Row] = []
    well = True
    with tempfile.TemporaryDirectory() as folder, Deployment(Path(folder)) as deployment:
        deployment.start()
        programs = {ROS1: deployment.ros1, ROS2: deployment.ros2}
        pairs = {direction: Pair((s, programs[s]()), (c, programs[c]())) for direction, (s, c) in WAYS.items()}
        goals = {}
        for direction, pair in pairs.items():
            pair.act(pair.name("long"), times=count, period=1 / args.rate)
            goals[direction] = pair.send(pair.name("long")), time.monotonic()
        for direction, pair in pairs.items():
            goal, began = goals[direction]
            state = pair.client.ask("goal", id=goal, until={"ends": 1}, seconds=args.minutes * 60 + SLACK)
            duration = time.monotonic() - began
            print(
                f"{direction}: status {state['status']}, reported {state['ends']} times, after {duration:.1f} s",
                flush=True,
            )
            well = well and state["status"] == SUCCEEDED and state["ends"] == 1
            rows.append(Row(f"{direction}, feedback", len(state["feedback"]), count, "messages", "more"))
    report(rows, args.json)
    return int(not well or any(row.ours != row.peer for row in rows))


if __name__ == "__main__":
    sys.exit(main())
