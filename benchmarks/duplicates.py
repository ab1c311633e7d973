"""What several real daemons on the same networks bring twice, and what they lose: both should be nothing.

The cases: two daemons in a ring (both join the same ROS 1 and the same ROS 2 network) and a triangle of three networks,
each with hubs that are joined and nodes of one name, and with hubs that are not and nodes that are renamed. All daemons
of a case start in the same moment. Then a program on each network publishes unique numbers, and one on each other
network counts what comes; rows hold the messages that came more than once and those that did not come, of all that were
to come, beside the none that is allowed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from tests.interop.several import Several, flows, pour, ring, triangle

CASES = {"ring": ring, "triangle": triangle}
HUBS = {"joined": True, "apart": False}
NODES = {"joined": "midspan", "apart": "bridge_of_ours"}
"""Name of every second daemon's nodes: the same as the first's, or another one."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; returns 1 where something came twice."""
    args = _parser().parse_args(arguments)
    rows: list[Row] = []
    for case in args.cases:
        for hubs in args.hubs:
            rows += measure(case, hubs, args.messages, args.rate)
    report(rows, args.json)
    return int(any(row.ours for row in rows if "twice" in row.case))


def measure(case: str, hubs: str, messages: int, rate: float) -> list[Row]:
    """One case with so many messages published on all networks together."""
    with tempfile.TemporaryDirectory(prefix="midspan-duplicates-") as folder, Several(Path(folder)) as several:
        _, networks = CASES[case](several, joined=HUBS[hubs], node=NODES[hubs])
        all_flows = flows(several, networks)
        share = messages // len(all_flows)
        pour(all_flows, share, rate / len(all_flows))
        tallies = [tally for flow in all_flows for tally in flow.tallies()]
        lost = sum(max(share - int(tally["distinct"]), 0) for tally in tallies)
        name = f"{case}, hubs {hubs}, {share * len(tallies)} to come"
        return [
            Row(f"{name}: came twice", sum(flow.duplicates() for flow in all_flows), 0, "messages"),
            Row(f"{name}: did not come", lost, 0, "messages"),
        ]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--hubs", nargs="+", choices=HUBS, default=list(HUBS))
    parser.add_argument("--messages", type=int, default=100_000, help="published in all, in each case")
    parser.add_argument("--rate", type=float, default=1000.0, help="messages per second, in all")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
