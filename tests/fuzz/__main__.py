"""``python -m tests.fuzz``: fuzz parsers by hand, for as long as you like; or look at one input that was found."""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.machines import load
from tests.fuzz.run import warm
from tests.fuzz.shrink import probe
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS
from tests.fuzz.watch import Fuzzing


def main() -> int:
    """Fuzz; 1 where something was found."""
    args = _arguments()
    chosen = [TARGETS[name] for name in args.target or TARGETS]
    if args.file is not None:
        return _look(chosen, args.file)
    begun = time.monotonic()
    fuzzing = Fuzzing(shares(chosen, args.inputs), args.seed, args.jobs, args.seconds)
    fuzzing.run()
    seconds = time.monotonic() - begun
    total = bad = 0
    print(f"{'target':<20}{'inputs':>10}{'seconds':>9}{'a second':>10}  found")
    for name, outcome in fuzzing.outcomes.items():
        total += outcome.inputs
        bad += len(outcome.findings)
        rate = outcome.inputs / outcome.seconds if outcome.seconds else 0.0
        print(f"{name:<20}{outcome.inputs:>10}{outcome.seconds:>9.1f}{rate:>10.0f}  {len(outcome.findings) or '-'}")
    print(f"{'all':<20}{total:>10}{seconds:>9.1f}{total / seconds:>10.0f}  {bad or '-'}   (seed {args.seed})")
    for name, outcome in fuzzing.outcomes.items():
        for finding in outcome.findings.values():
            digest = hashlib.sha256(finding.content).hexdigest()[:12]
            file = args.save / f"{name}-{digest}"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(finding.content)
            print(f"\n== {name}: {finding.signature} (seed {args.seed})\n{finding.trouble}")
            print(f"input of {len(finding.content)} bytes: {finding.content[:300]!r}")
            print(f"again: python -m tests.fuzz --target {name} --file {file}")
    if args.json is not None:
        args.json.write_text(
            json.dumps({n: {"inputs": o.inputs, "seconds": o.seconds} for n, o in fuzzing.outcomes.items()})
        )
    return 1 if bad else 0


def shares(targets: Sequence[Target], inputs: int) -> dict[Target, int]:
    """How many inputs each target gets, at least one."""
    whole = sum(target.share for target in targets)
    counts = {target: max(inputs * target.share // whole, 1) for target in targets}
    first = next(iter(counts))
    counts[first] += max(inputs - sum(counts.values()), 0)
    return counts


def _look(targets: Sequence[Target], file: Path) -> int:
    load()
    for target in targets:
        subject = target.make()
        warm(subject)
        how = probe(subject, file.read_bytes())
        print(f"{target.name}: {how or 'as promised'}")
        if how:
            return 1
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument(
        "--target", action="append", choices=list(TARGETS), metavar="NAME", help="one parser, again for more"
    )
    parser.add_argument("--inputs", type=int, default=1_000_000, help="how many in all (default a million)")
    parser.add_argument("--seconds", type=float, default=math.inf, help="of processor time for each target at most")
    parser.add_argument("--seed", type=int, default=1, help="another seed makes other inputs (default 1)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--file", type=Path, help="give the parser this one input and say what it does")
    parser.add_argument(
        "--save", type=Path, default=Path(tempfile.gettempdir()) / "midspan-fuzz", metavar="FOLDER",
        help="where inputs go that were found (default %(default)s)",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
