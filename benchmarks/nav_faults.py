"""The behavior of a driving robot while something fails, with the whole deployment from simulator to gateway.

Printed for each fault are the seconds and meters until the wheels stood, the status that the client received, whether
the robot continued by itself, and how the goal ended. The rows contain the seconds until the wheels stood; their "peer"
is the allowed time. Links are cut between two network namespaces, which needs root and iproute2.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.navfaults.cases import FAULTS
from benchmarks.rows import Row, add_json_option, report


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 1 if an outcome was wrong."""
    args = _parser().parse_args(arguments)
    chosen = [fault for fault in FAULTS if args.faults is None or fault.key in args.faults]
    rows, wrong = [], 0
    for fault in chosen:
        with tempfile.TemporaryDirectory(prefix="midspan-nav-faults-") as folder, fault.where(Path(folder)) as chain:
            chain.start()
            chain.client.call("/sim/remove", "midspan_msgs/srv/Named", name="anna")
            outcome = fault.happen(chain, args.place)
            print(f"{fault.key:<26} {outcome}", flush=True)
            wrong += bool(outcome.wrong)
            if outcome.wrong and args.log:
                print(chain.output())
        if math.isfinite(fault.limit):
            rows.append(Row(f"{fault.key}: until the wheels stand", outcome.still, fault.limit, "s"))
    print()
    report(rows, args.json)
    return int(wrong > 0)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", nargs="+", choices=[fault.key for fault in FAULTS], metavar="FAULT")
    parser.add_argument("--place", default="kitchen", help="destination (default kitchen)")
    parser.add_argument("--log", action="store_true", help="print the daemon's log if an outcome was wrong")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
