"""Runs the tests repeatedly, each time in another order, and lists the tests that failed at least once.

    python scripts/flaky.py 5                           `make test`, five times
    python scripts/flaky.py 20 tests/hub -k latched     only some tests: arguments for pytest
    python scripts/flaky.py 5 --target test-all         another target
    python scripts/flaky.py 3 --busy 4                  with four busy processes in the background
    python scripts/flaky.py 1 --one-core                everything on one core

The output of each run is kept in .cache/flaky. To repeat the order of run 3: ``make test ARGS='--randomly-seed=3'``.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

_FAILED = re.compile(r"^(?:FAILED|ERROR) (?! )(.+?)(?: - .*)?$|^(LEFT BEHIND: .*)$", re.MULTILINE)
"""Lines of pytest's summary (``-ra``), and one of tests/conftest.py; a log line has more spaces after its level."""

_COMPUTE = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: sum(range(100_000))"
"""A process that computes until its parent has exited in any manner."""


@dataclass(frozen=True)
class Run:
    """One run of the tests.

    Attributes:
        seed: the seed of the tests' order, which is also the run's number.
        seconds: the run's duration.
        failed: the tests that failed, once each, and leftovers such as processes.
        last: the last line of the output.
    """

    seed: int
    seconds: float
    failed: tuple[str, ...]
    last: str


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tests; return 1 if any run failed."""
    args, pytest = _parser().parse_known_args(arguments)
    if args.one_core:
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    args.logs.mkdir(parents=True, exist_ok=True)
    runs = []
    with busy(args.busy):
        for seed in range(args.seed, args.seed + args.runs):
            run = run_once(args.target, pytest, seed, args.logs / f"run-{seed}.log")
            print(f"run {seed}: {run.seconds:.0f} s, {len(run.failed) or 'nothing'} failed: {run.last}", flush=True)
            runs.append(run)
    red = [run for run in runs if run.failed]
    print(f"\n{len(red)} of {len(runs)} runs failed")
    for name, seeds in ever_failed(red):
        print(f"{len(seeds):>4} of {len(runs)}  {name}  (run {', '.join(map(str, seeds))})")
    return 1 if red else 0


def run_once(target: str, pytest: Sequence[str], seed: int, log: Path) -> Run:
    """Run the tests once, in the order of a seed; their output goes to a file."""
    arguments = shlex.join([*pytest, f"--randomly-seed={seed}"]).replace("$", "$$")
    began = time.monotonic()
    with log.open("wb") as file:
        command = ["make", "-C", str(ROOT), "--no-print-directory", target, "STRICT=1", f"ARGS={arguments}"]
        code = subprocess.run(command, stdout=file, stderr=subprocess.STDOUT, check=False).returncode
    text = log.read_text(encoding="utf-8", errors="replace")
    failed = dict.fromkeys(test or left for test, left in _FAILED.findall(text))
    if code and not failed:
        failed = {f"no test: make ended with exit code {code}, see {log}": None}
    lines = [line.strip("= ") for line in text.splitlines() if line.strip("= ")]
    return Run(seed, time.monotonic() - began, tuple(failed), lines[-1] if lines else "")


def ever_failed(runs: Sequence[Run]) -> list[tuple[str, list[int]]]:
    """Return the failed tests, the most frequent first, each with the seeds of its runs."""
    seeds: dict[str, list[int]] = defaultdict(list)
    for run in runs:
        for name in run.failed:
            seeds[name].append(run.seed)
    return sorted(seeds.items(), key=lambda item: -len(item[1]))


@contextmanager
def busy(count: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Keep a number of processes computing in the background."""
    processes = [subprocess.Popen([sys.executable, "-c", _COMPUTE]) for _ in range(count)]
    try:
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/flaky.py", description="Run the tests repeatedly; other arguments are passed to pytest."
    )
    parser.add_argument("runs", type=int, help="number of runs")
    parser.add_argument("--target", default="test", choices=("test", "test-fast", "test-all"), help="target of make")
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the first run's order (1), incremented for each run"
    )
    parser.add_argument("--busy", type=int, default=0, metavar="N", help="run N busy processes in the background")
    parser.add_argument("--one-core", action="store_true", help="run everything on one core")
    parser.add_argument("--logs", type=Path, default=ROOT / ".cache" / "flaky", help="folder for the output")
    return parser


if __name__ == "__main__":
    sys.exit(main())
