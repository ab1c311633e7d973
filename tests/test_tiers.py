"""Which tests belong to which of `make test-fast`, `make test` and `make test-all`, and which run last."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.support import tiers
from tests.support.inner_run import run_tests
from tests.support.scheduler import TOGETHER, Scheduler

ROOT = Path(__file__).parents[1]

CONFTEST = """
from pathlib import Path
from tests.support.scheduler import Scheduler

def pytest_xdist_make_scheduler(config, log):
    return Scheduler(config, log)

def pytest_runtest_call(item):
    with Path("log").open("a") as log:
        log.write(f"begin {item.name}\\n")

def pytest_runtest_teardown(item):
    with Path("log").open("a") as log:
        log.write(f"end {item.name}\\n")
"""

MEETS = """
import time
from pathlib import Path

def test_{0}():
    end = time.monotonic() + 40
    while "begin test_{1}\\n" not in Path("log").read_text():
        assert time.monotonic() < end, "the other test does not run at the same time"
        time.sleep(0.01)

def test_last_{0}(): ...  # which waits until it is known what comes next
"""

ALONE = """
import pytest

@pytest.mark.alone
@pytest.mark.parametrize("number", range(3))
def test_{0}_alone(number): ...
"""


@pytest.mark.thorough
@pytest.mark.parametrize("processes", ["2", "4"])
def test_tests_marked_alone_run_last_a_few_at_a_time(tmp_path: Path, processes: str) -> None:
    """The other tests do run concurrently."""
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = alone")
    (tmp_path / "conftest.py").write_text(CONFTEST)
    for test_name, other in (("left", "right"), ("right", "left")):
        (tmp_path / f"test_{test_name}.py").write_text(MEETS.format(test_name, other) + ALONE.format(test_name))
    (tmp_path / "test_more.py").write_text(ALONE.format("more"))
    run = run_tests(tmp_path, "--dist", "loadfile", "-n", processes)
    assert "13 passed" in run.stdout, run.stdout + run.stderr
    running: set[str] = set()
    begun = []
    for event, name in (line.split() for line in (tmp_path / "log").read_text().splitlines()):
        (running.add if event == "begin" else running.discard)(name)
        begun += [name] * (event == "begin")
        assert len(running) <= TOGETHER or not any("alone" in name for name in running), running
    assert len(begun) == 13
    assert not [name for name in begun[:2] if "alone" in name]


class Node:
    """A process of pytest-xdist that accepts tests and runs none."""

    shutting_down = False

    def __init__(self, name: str) -> None:
        self.gateway = SimpleNamespace(id=name)
        self.given: list[int] = []

    def send_runtest_some(self, numbers: list[int]) -> None:
        self.given += numbers

    def shutdown(self) -> None:
        self.shutting_down = True


def scheduled(folder: Path, names: list[str], processes: int) -> dict[str, list[str]]:
    """Return the files that each process is given first."""
    config = SimpleNamespace(
        rootpath=folder, getvalue=lambda _name: ["popen"] * processes, option=SimpleNamespace(loadscopereorder=False)
    )
    scheduler = Scheduler(config, None)  # type: ignore[arg-type]
    nodes = [Node(f"gw{number}") for number in range(processes)]
    for node in nodes:
        scheduler.add_node(node)  # type: ignore[arg-type]
    for node in nodes:
        scheduler.add_node_collection(node, [f"{name}::test" for name in names])  # type: ignore[arg-type]
    scheduler.schedule()
    return {node.gateway.id: [names[number] for number in node.given] for node in nodes}


def test_long_tests_that_are_alone_start_first(tmp_path: Path) -> None:
    names = ["test_a.py", "test_b.py", "test_long.py", "test_c.py", "test_d.py", "test_e.py"]
    for name in names:
        (tmp_path / name).write_text(
            ("@pytest.mark.long\n" if "long" in name else "") + "@pytest.mark.alone\ndef test(): ..."
        )
    given = scheduled(tmp_path, names, 2)
    assert "test_long.py" in {given["gw0"][0], given["gw1"][0]}


def test_two_processes_start_with_long_tests_and_the_others_skip_them(tmp_path: Path) -> None:
    names = [*(f"test_{number}.py" for number in range(8)), *(f"test_long_{number}.py" for number in range(3))]
    for name in names:
        (tmp_path / name).write_text("@pytest.mark.long" if "long" in name else "")
    given = scheduled(tmp_path, names, 6)
    assert given["gw0"][0] == "test_0.py"
    assert given["gw2"][0] == "test_long_2.py"
    assert given["gw3"][0] == "test_long_1.py"
    assert [name for node in ("gw0", "gw1", "gw4", "gw5") for name in given[node] if "long" in name] == []


def test_files_that_share_a_rig_go_to_one_process(tmp_path: Path) -> None:
    shared = [f"tests/web/browser/test_{number}.py" for number in range(3)]
    names = [*shared, *(f"test_{number}.py" for number in range(5))]
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    given = scheduled(tmp_path, names, 2)
    assert any(set(shared) <= set(files) for files in given.values())


def test_the_marker_alone_applies_to_functions_and_to_whole_files(tmp_path: Path) -> None:
    some, every, none = tmp_path / "some.py", tmp_path / "every.py", tmp_path / "none.py"
    some.write_text(ALONE.format("one") + "def test_two(): ...")
    every.write_text("pytestmark = [pytest.mark.alone]\n\ndef test_one(): ...\n\ndef test_two(): ...")
    none.write_text("def test_one(): ...")
    assert tiers.alone(some) == {"test_one_alone"}
    assert tiers.alone(every) == {"test_one", "test_two"}
    assert not tiers.alone(none)


def test_every_marker_alone_is_seen_by_the_scheduler(request: pytest.FixtureRequest) -> None:
    marked = {item for item in request.session.items if item.get_closest_marker("alone")}
    seen = {item for item in request.session.items if item.name.partition("[")[0] in tiers.alone(item.path)}
    assert marked == seen


@pytest.mark.parametrize("file", ["interop/test_topics.py", "adapters/yarp/test_ports.py", "hub/test_router.py"])
def test_a_file_that_reaches_a_middleware_is_not_fast(file: str) -> None:
    assert not tiers.is_fast(ROOT / "tests" / file)


@pytest.mark.parametrize("file", ["messages/yarp/test_natural.py", "routing/test_rules.py", "test_layers.py"])
def test_a_file_that_needs_none_is_fast(file: str) -> None:
    assert tiers.is_fast(ROOT / "tests" / file)


@pytest.mark.parametrize(
    ("text", "modules"),
    [
        ("import os, zenoh\n", {"os", "zenoh"}),
        ("def f():\n    import numpy as np  # here\n", {"numpy"}),
        ("from a.b import c as d, e\n", {"a.b", "a.b.c", "a.b.e"}),
        ("from a import (\n    b,\n    c,  # late\n)\n", {"a", "a.b", "a.c"}),
        ("text = 'import nothing'\n", set()),
    ],
)
def test_imports_are_found(tmp_path: Path, text: str, modules: set[str]) -> None:
    file = tmp_path / "file.py"
    file.write_text(text)
    assert tiers.imports(file) == modules
