"""The examples in docs/yarp/python.md run, each as a separate program."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.ports import free_port
from yarp_compat.naming.server import NameServer

PAGE = Path(__file__).parents[2] / "docs" / "yarp" / "python.md"
EXAMPLES = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    folder = tmp_path_factory.mktemp("yarp")
    with NameServer(port=free_port()) as server:
        (folder / "yarp.conf").write_text(f"{server.address.host} {server.address.port} yarp\n")
        yield os.environ | {"YARP_CONFIG_HOME": str(folder)}


@pytest.mark.parametrize("example", EXAMPLES, ids=range(1, len(EXAMPLES) + 1))
def test_the_examples_run(environment: dict[str, str], example: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", example], env=environment, timeout=100, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    errors = [line for line in done.stderr.splitlines() if "[ERROR]" in line and "yarp.dev.PolyDriver" not in line]
    assert not errors, "there are no errors except those of devices, whose servers are missing"


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == 8
