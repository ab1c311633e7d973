"""Reruns the tests that failed in `make test` or `make test-all`, one after the other.

The exit code is 1 if a test fails again, or if many tests failed. A test that passes now is UNSTEADY. The first run's
output has its traceback; the end has its name, and the seed of the order in which it failed. Each such test is a
defect, of the test or of Midspan.
CONTRIBUTING.md ("Unsteady tests") has the rules.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / ".cache" / "pytest"
"""The ``cache_dir`` of the earlier pytest runs."""

SEED = "midspan/seed"
"""Name of the order's seed in that cache, written by tests/conftest.py."""

MOST = 5
"""Maximum number of failed tests that are rerun; if more failed, races are not the cause."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Rerun the failed tests; return 1 if one fails again."""
    parser = argparse.ArgumentParser(prog="scripts/unsteady.py", description="Rerun failed tests.")
    parser.add_argument("--kept", type=Path, default=KEPT, help="cache_dir of the earlier pytest runs")
    values = parser.parse_args(arguments).kept / "v"
    failed = sorted(_value(values / "cache" / "lastfailed") or ())
    if not 0 < len(failed) <= MOST:  # none: the run failed for another reason
        print(f"{len(failed)} tests failed", *failed, sep="\n  ")
        return 1
    print(f"\n== once more, one by one: {len(failed)}", flush=True)
    pytest = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:randomly", *failed]
    if subprocess.run(pytest, cwd=ROOT, check=False).returncode:
        return 1
    order = f"--randomly-seed={_value(values / SEED)}"
    print(f"UNSTEADY, to be fixed: {len(failed)} failed in the whole run ({order}) and passed now", end="\n  ")
    print(*failed, sep="\n  ")
    return 0


def _value(file: Path) -> Any:
    """Return a value from the cache of pytest, None if it is missing."""
    return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None


if __name__ == "__main__":
    sys.exit(main())
