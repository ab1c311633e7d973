"""Runs what failed in a red `make test-all` once more, by itself; CI does so (CONTRIBUTING.md, "Unsteady tests").

A test that fails again, or a run in which many failed, is red. One that passes by itself is unsteady: its traceback
stands above, its name at the end. Each is a defect to mend, of the test or of Midspan.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / ".cache" / "pytest"
"""Pytest's ``cache_dir`` of the runs before."""

MOST = 5
"""Failed tests of a run that may be races; more are none."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run them; 1 where one fails again."""
    parser = argparse.ArgumentParser(prog="scripts/unsteady.py", description="Run what failed once more, by itself.")
    parser.add_argument("--kept", type=Path, default=KEPT, help="pytest's cache_dir of the runs before")
    file = parser.parse_args(arguments).kept / "v" / "cache" / "lastfailed"
    failed = sorted(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else []
    if not 0 < len(failed) <= MOST:  # none: the run failed for another reason
        print(f"{len(failed)} tests failed", *failed, sep="\n  ")
        return 1
    print(f"\n== once more, by themselves: {len(failed)}", flush=True)
    pytest = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:randomly", *failed]
    if subprocess.run(pytest, cwd=ROOT, check=False).returncode:
        return 1
    print(f"UNSTEADY, to be mended: {len(failed)} failed among the others and passed alone", *failed, sep="\n  ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
