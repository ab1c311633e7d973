"""``python -m tests.fuzz``: fuzz parsers by hand, or run a single input."""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import math
import sys
import tempfile
import time
import zlib
from collections.abc import Sequence
from pathlib import Path

from tests.fuzz.machines import load
from tests.fuzz.run import Finding, warm
from tests.fuzz.shrink import probe
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS
from tests.fuzz.watch import Fuzzing

MARK = "== "
"""Begins the text of each finding."""

_LONGEST_INPUT = 4000
"""Maximum characters of a finding's compressed input in its text."""


def main() -> int:
    """Fuzz the selected targets; return 1 if there are findings."""
    args = _arguments()
    chosen = [TARGETS[name] for name in args.target or TARGETS]
    content = args.file.read_bytes() if args.file is not None else args.input
    if content is not None:
        return _run_input(chosen, content)
    begun = time.monotonic()
    fuzzing = Fuzzing(shares(chosen, args.inputs), args.seed, args.jobs, args.seconds)
    fuzzing.run()
    seconds = time.monotonic() - begun
    total = bad = 0
    print(f"{'target':<20}{'inputs':>10}{'seconds':>9}{'per second':>11}  findings")
    for name, outcome in fuzzing.outcomes.items():
        total += outcome.inputs
        bad += len(outcome.findings)
        rate = outcome.inputs / outcome.seconds if outcome.seconds else 0.0
        print(f"{name:<20}{outcome.inputs:>10}{outcome.seconds:>9.1f}{rate:>11.0f}  {len(outcome.findings) or '-'}")
    print(f"{'all':<20}{total:>10}{seconds:>9.1f}{total / seconds:>11.0f}  {bad or '-'}   (seed {args.seed})")
    for name, outcome in fuzzing.outcomes.items():
        for finding in outcome.findings.values():
            digest = hashlib.sha256(finding.content).hexdigest()[:12]
            file = args.save / f"{name}-{digest}"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(finding.content)
            print(report(name, finding, args.seed, file))
    if args.json is not None:
        args.json.write_text(
            json.dumps({n: {"inputs": o.inputs, "seconds": o.seconds} for n, o in fuzzing.outcomes.items()})
        )
    return 1 if bad else 0


def report(name: str, finding: Finding, seed: int, file: Path) -> str:
    """Return a finding's text, with a command that reproduces it: without the file, unless the input is too long."""
    packed = base64.b64encode(zlib.compress(finding.content, 9)).decode()
    given = f"--input {packed}" if len(packed) <= _LONGEST_INPUT else f"--file {file}"
    return (
        f"\n{MARK}{name}: {finding.signature} (seed {seed})\n{finding.trouble}\n"
        f"input of {len(finding.content)} bytes in {file}: {finding.content[:300]!r}\n"
        f"reproduce: python -m tests.fuzz --target {name} {given}"
    )


def _unpacked(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))


def shares(targets: Sequence[Target], inputs: int) -> dict[Target, int]:
    """Return each target's number of inputs, which is at least one."""
    whole = sum(target.share for target in targets)
    counts = {target: max(inputs * target.share // whole, 1) for target in targets}
    first = next(iter(counts))
    counts[first] += max(inputs - sum(counts.values()), 0)
    return counts


def _run_input(targets: Sequence[Target], content: bytes) -> int:
    load()
    for target in targets:
        subject = target.make()
        warm(subject)
        failure = probe(subject, content)
        print(f"{target.name}: {failure or 'passed'}")
        if failure:
            return 1
    return 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument(
        "--target", action="append", choices=list(TARGETS), metavar="NAME", help="parser to fuzz; may be repeated"
    )
    parser.add_argument("--inputs", type=int, default=1_000_000, help="total number of inputs (default a million)")
    parser.add_argument("--seconds", type=float, default=math.inf, help="maximum processor time per target")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random inputs (default 1)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--file", type=Path, help="run the parser on this input only")
    parser.add_argument(
        "--input", type=_unpacked, metavar="BASE64", help="run the parser on this input only, as findings print it"
    )
    parser.add_argument(
        "--save", type=Path, default=Path(tempfile.gettempdir()) / "midspan-fuzz", metavar="FOLDER",
        help="folder for inputs that fail (default %(default)s)",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
