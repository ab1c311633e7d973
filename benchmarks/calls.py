"""Round trips of services, actions and cancel requests between ROS 1 and ROS 2 through the daemon, and their floor.

The floor is the sum of the same round trip from rospy to rospy, from zenoh to zenoh and from rclpy to rclpy. Each round
trip is measured in the same run, in turns with the whole path, as in `topic_latency.py`. The ends use typed messages,
actionlib, and an executor of rclpy for each client and server, so that these do not delay each other. The floor is the
work of six programs, the whole path is the work of two programs and two workers, which explains ratios below 1. Each
round starts new processes.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.latency.figures import Figures, figures, floor, over_rounds
from benchmarks.latency.stage import Stage
from benchmarks.rows import Row, add_json_option, report

FLOOR, THERE, BACK = "/floor", "/there", "/back"
HOPS = ("ros1", "zenoh", "ros2")
WAYS = {THERE: ("ROS 1 client, ROS 2 server", "ros1", "ros2"), BACK: ("ROS 2 client, ROS 1 server", "ros2", "ros1")}
TURNS = 4  # turns per round of each hop and direction
WARM = 3  # number of round trips at the beginning of a turn that do not count


@dataclass(frozen=True, slots=True)
class Case:
    """One kind of round trip; its p50 should be at most ``mark`` times the floor."""

    key: str
    name: str
    count: int
    mark: float


CASES = (
    Case("call", "SetBool", 200, 1.5),
    Case("map", "GetMap 1 MB", 40, 1.25),
    Case("go", "goal to result", 100, 1.5),
    Case("hold", "cancel to end", 60, 1.5),
)


class Network(Stage):
    """The processes of one round, all newly started."""

    def __init__(self) -> None:
        super().__init__({
            "ros1": {"poll": 0.1},
            "ros2": {"transport": "shared_memory"},  # as in the ends; "auto" depends on other programs on the machine
            "routing": {"rules": [{"topic": f"{FLOOR}/**", "deny": True}]},
            "log": {"level": "warning"},
        })  # fmt: skip
        try:
            self.start_bridge()
            for kind in HOPS:
                for role in ("server", "client"):
                    arguments = [f"tcp/127.0.0.1:{self.place.router_port}"] if kind == "zenoh" else []
                    module = f"benchmarks.roundtrips.{kind}_end"
                    self.launch(f"{kind} {role}", module, *arguments, system=kind == "ros1")
            for kind in HOPS:
                for role in ("server", "client"):
                    self.wait_for(f"{kind} {role}", "ready")
            self._find()
        except BaseException:
            self.close()
            raise

    def _find(self) -> None:
        for kind in HOPS:
            self.command(f"{kind} server", "serve", "serving", prefix=FLOOR)
            self.command(f"{kind} client", "find", "found", prefix=FLOOR)
        for direction, (_, client, server) in WAYS.items():
            self.launch(f"{direction} server", f"benchmarks.roundtrips.{server}_end", system=server == "ros1")
            self.wait_for(f"{direction} server", "ready")
            self.command(f"{direction} server", "serve", "serving", prefix=direction)
            self.command(f"{client} client", "find", "found", prefix=direction)

    def measure(self, case: Case, hop: str, count: int) -> list[int]:
        """Return round trips in nanoseconds, without the first ones."""
        client, prefix = (WAYS[hop][1], hop) if hop in WAYS else (hop, FLOOR)
        wanted = {"prefix": prefix, "case": case.key, "count": WARM + count, "pause": 0.005}
        times: list[int] = self.command(f"{client} client", "measure", "measured", **wanted)["times"]
        return times[WARM:]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 1 if a limit is exceeded and ``--check`` is given."""
    args = _parser().parse_args(arguments)
    cases = [case for case in CASES if args.cases is None or case.key in args.cases]
    measured: dict[tuple[str, str], list[Figures]] = defaultdict(list)
    floors: dict[str, list[Figures]] = defaultdict(list)
    for number in range(args.rounds):
        print(f"round {number + 1} of {args.rounds}", file=sys.stderr, flush=True)
        with Network() as network:
            for case in cases:
                times: dict[str, list[int]] = defaultdict(list)
                for _ in range(TURNS):
                    for hop in ("ros1", THERE, "zenoh", BACK, "ros2"):
                        times[hop] += network.measure(case, hop, case.count // TURNS)
                for hop, durations in times.items():
                    measured[case.key, hop].append(figures(durations))
                floors[case.key].append(floor([times[hop] for hop in HOPS], number))
    print("hops in us (p50 / p99), whose sum is the floor:", file=sys.stderr)
    for case in cases:
        hop_figures = ((hop, over_rounds(measured[case.key, hop])) for hop in HOPS)
        line = "".join(f"  {hop} {f.p50:7.0f} /{f.p99:7.0f}" for hop, f in hop_figures)
        print(f"  {case.name:<16}{line}", file=sys.stderr)
    rows = []
    for case in cases:
        peer = over_rounds(floors[case.key])
        for direction, (name, _, _) in WAYS.items():
            ours = over_rounds(measured[case.key, direction])
            rows += [Row(f"{case.name}, {name}, {f}", getattr(ours, f), getattr(peer, f), "us") for f in ("p50", "p99")]
    report(rows, args.json)
    marks = {case.name: case.mark for case in cases}
    missed = [r for r in rows if r.case.endswith("p50") and r.ratio > marks[r.case.split(", ")[0]]]
    for row in missed:
        print(f"above its limit of {marks[row.case.split(', ')[0]]:g}: {row.case}: {row.ratio:.2f}")
    return 1 if missed and args.check else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--cases", nargs="+", choices=[case.key for case in CASES], help="kinds of round trips to measure (default all)"
    )
    parser.add_argument(
        "--rounds", type=int, default=5, metavar="N", help="rounds, each with new processes (default 5)"
    )
    parser.add_argument("--check", action="store_true", help="exit with code 1 if a ratio is above its limit")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
