"""Recovery after a loss, with the real daemon between real ROS 1, ROS 2 and hub programs.

Each loss is caused several times (default 10). For each, the benchmark prints:
- how often all messages flowed again without help;
- the seconds until then, from the moment at which the lost part was back (or from the loss, if the daemon restarts it);
- the longest silence of a stream;
- delivered stale commands, duplicate stream messages, latched lines that old or new subscribers miss, and leftovers of
  dead processes on the networks.

The rows contain the seconds; their "peer" is the time that the project allows.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.losses.cases import LOSSES, Loss
from benchmarks.losses.field import Field
from benchmarks.losses.litter import litter
from benchmarks.losses.outcome import Outcome
from benchmarks.rows import Row, add_json_option, report

LITTER = "litter"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return 1 if a recovery failed or was wrong, or left something behind."""
    args = _parser().parse_args(arguments)
    chosen = [loss for loss in LOSSES if args.cases is None or loss.key in args.cases]
    outcomes: dict[str, list[Outcome]] = defaultdict(list)
    left: list[Row] = []
    with Field() as field:
        for number in range(args.times if chosen else 0):
            for loss in chosen:
                began = time.monotonic()
                outcome = loss.happen(field)
                outcomes[loss.key].append(outcome)
                duration = time.monotonic() - began
                print(f"{number + 1}/{args.times} {loss.key:<17} {outcome} (took {duration:.0f} s)", flush=True)
        if args.cases is None or LITTER in args.cases:
            left = litter(field, args.kills)
    print()
    for loss in chosen:
        print(_summary(loss, outcomes[loss.key]))
    rows = [row for loss in chosen for row in _rows(loss, outcomes[loss.key])] + left
    print()
    report(rows, args.json)
    wrong = any(not o.good for os in outcomes.values() for o in os)
    return int(wrong or any(row.ours > row.peer for row in left if row.unit == "files"))


def _summary(loss: Loss, outcomes: Sequence[Outcome]) -> str:
    back = [o for o in outcomes if o.recovered]
    p50, p95, most = _spread([o.seconds for o in back])
    return (
        f"{loss.name:<52} {len(back)}/{len(outcomes)} in {p50:.2f} / {p95:.2f} / {most:.2f} s (p50/p95/max),"
        f" silence up to {max(o.gap for o in outcomes):.2f} s; stale commands {sum(o.stale for o in outcomes)},"
        f" twice {sum(o.twice for o in outcomes)}, latched lines missing {sum(len(o.missing) for o in outcomes)},"
        f" left behind {sum(len(o.left) for o in outcomes)}"
    )


def _rows(loss: Loss, outcomes: Sequence[Outcome]) -> list[Row]:
    back = [o for o in outcomes if o.recovered]
    values = _spread([o.seconds for o in back])
    rows = [Row(f"{loss.name}, {n}", v, loss.limit, "s") for n, v in zip(("p50", "p95", "max"), values, strict=True)]
    return [*rows, Row(f"{loss.name}, recovered well", sum(o.good for o in outcomes), len(outcomes), "times", "more")]


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    """Return median, 95th percentile and maximum; infinite without values."""
    if not values:
        return (float("inf"),) * 3
    ordered = sorted(values)
    return statistics.median(ordered), ordered[min(len(ordered) - 1, round(0.95 * len(ordered)))], ordered[-1]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--cases", nargs="+", choices=[*(loss.key for loss in LOSSES), LITTER], help="losses to cause (default all)"
    )
    parser.add_argument("--times", type=int, default=10, metavar="N", help="repetitions of each loss (default 10)")
    parser.add_argument("--kills", type=int, default=20, metavar="N", help="kills of the case litter (default 20)")
    add_json_option(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
