"""An older release of Midspan together with this one: its files come from the history and run in separate processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.process import Process
from tests.support.wait import until

ROOT = Path(__file__).parents[3]
RELEASE = "d6b37d89e995789d8d8920127709dce0aac44feb"
"""A commit of 0.1 from before Midspan announced its protocol version."""

MISSING = f"not on this machine: the history back to {RELEASE[:8]} (git fetch --unshallow)"

WORKER = "import sys\nfrom bridge.cli.main import main\nsys.exit(main(sys.argv[1:]))\n"
STORE = """
import json, sys
from pathlib import Path
from bridge.stores.kinds import LOCATION
from tests.stores.parts import Shared
from yarp_compat.dev.locations import Map2DLocation

folder, name, router, domain = sys.argv[1:]
with Shared(Path(folder), name, router, domain=int(domain)) as shared:
    print(json.dumps(shared.others()), flush=True)
    for line in sys.stdin:
        verb, *words = json.loads(line)
        if verb == "put":
            shared.store.put(LOCATION, words[0], Map2DLocation(map_id="m", x=words[1], y=0.0, theta=0.0))
        elif verb == "delete":
            shared.store.delete(LOCATION, words[0])
        locations = {each: shared.store.get(LOCATION, each) for each in shared.store.names(LOCATION)}
        found = {each: at.x for each, at in locations.items() if at is not None}  # the other store may delete meanwhile
        print(json.dumps([found, shared.others(), shared.replica.conflict_count]), flush=True)
"""


def older_tree(folder: Path) -> Path:
    """Extract the older release's files; skip the test, or fail in CI, if the history is truncated."""
    done = subprocess.run(
        ["git", "archive", RELEASE, "bridge", "yarp_compat", "navigation", "sim", "tests", "pyproject.toml"],
        cwd=ROOT, capture_output=True, check=False,
    )  # fmt: skip
    if done.returncode:
        pytest.skip(MISSING)
    subprocess.run(["tar", "-x", "-C", folder], input=done.stdout, check=True)
    return folder


@contextmanager
def python(tree: Path, code: str, *words: str | Path, pipes: bool = False) -> Iterator[Process]:
    """Start a program with the Midspan of a source tree."""
    environ = {**os.environ, "PYTHONPATH": str(tree), "PYTHONSAFEPATH": "1"}
    with Process([sys.executable, "-c", code, *words], environ, pipes=pipes) as process:
        try:
            yield process
        except BaseException:
            print(process.output())
            raise


class OtherStore:
    """A store in the Midspan of a source tree, controlled line by line."""

    def __init__(self, process: Process) -> None:
        self._process = process
        self._read()

    def _read(self) -> Any:
        out = self._process.popen.stdout
        assert out is not None
        line = out.readline()
        assert line, self._process.output()
        return json.loads(line)

    def ask(self, *words: Any) -> tuple[dict[str, float], list[str], int]:
        """Execute a command; return the locations, the other stores, and the number of conflicts."""
        into = self._process.popen.stdin
        assert into is not None
        into.write(json.dumps(words) + "\n")
        into.flush()
        result, others, conflicts = self._read()
        return result, others, conflicts

    def until(self, found: dict[str, float]) -> None:
        """Wait until the store contains these locations."""
        until(lambda: self.ask("look")[0] == found, f"the store contains {found}", 30)
