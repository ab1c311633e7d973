"""Duplicate and lost messages with several real daemons on the same networks; there should be none of either.

There are two cases: a ring of two daemons, which join the same ROS 1 and the same ROS 2 network, and a triangle of
three networks. Each runs with joined hubs and equal node names, and with separate hubs and different node names. All
daemons of a case start at the same time. Then a program on each network publishes unique numbers, and a program on each
other network counts them. The rows are the duplicates and the losses among all expected messages; the peer is the
allowed number, 0.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.rows import Row, add_json_option, report
from tests.peers.daemon.several import Several, flows, pour, ring, triangle

CASES = {"ring": ring, "triangle": triangle}
HUBS = {"joined": True, "apart": False}
NODES = {"joined": "midspan", "apart": "bridge_of_ours"}
"""Node name of every second daemon: the first daemon's name, or another name."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 1 if a message arrived twice."""
    args = _parser().parse_args(arguments)
    rows: list[Row] = []
    for case in args.cases:
        for hubs in args.hubs:
            rows += measure(case, hubs, args.messages, args.rate)
    report(rows, args.json)
    return int(any(row.ours for row in rows if "twice" in row.case))


def measure(case: str, hubs: str, messages: int, rate: float) -> list[Row]:
    """Measure one case; ``messages`` and ``rate`` (per second) are the totals of all publishers."""
    with tempfile.TemporaryDirectory(prefix="midspan-duplicates-") as folder, Several(Path(folder)) as several:
        _, networks = CASES[case](several, joined=HUBS[hubs], node=NODES[hubs])
        all_flows = flows(several, networks)
        share = messages // len(all_flows)
        pour(all_flows, share, rate / len(all_flows))
        tallies = [tally for flow in all_flows for tally in flow.tallies()]
        lost = sum(max(share - int(tally["distinct"]), 0) for tally in tallies)
        name = f"{case}, hubs {hubs}, {share * len(tallies)} expected"
        return [
            Row(f"{name}: duplicates", sum(flow.duplicates() for flow in all_flows), 0, "messages"),
            Row(f"{name}: lost", lost, 0, "messages"),
        ]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--hubs", nargs="+", choices=HUBS, default=list(HUBS))
    parser.add_argument("--messages", type=int, default=100_000, help="total number of messages published in each case")
    parser.add_argument("--rate", type=float, default=1000.0, help="total number of messages per second")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
