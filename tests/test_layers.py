"""Imports point one way, as the design's layout says."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TOOLS = {"clock", "concurrency", "progress", "resources", "shipped", "sides", "state_file", "worker"}
"""Single files that stand beside the parts; they import nothing of ``bridge`` but ``config``."""

BELOW = {
    "config": {"sides"},
    "messages": set[str](),
    "tf": set(),
    "tf/server": {"tf", "clock", "config", "hub", "messages", "modules", "worker"},
    "interfaces": {"config", "messages"},
    "hub": {*TOOLS, "config", "messages"},
    "stores": {*TOOLS, "config", "hub"},
    "routing": {*TOOLS, "config", "messages", "hub"},
    "modules": {
        *TOOLS,
        "callers",
        "config",
        "messages",
        "hub",
        "stores",
        "routing.counters",
        "routing.limits",
    },
    "bags": {
        *TOOLS,
        "config",
        "messages",
        "hub",
        "modules",
        "routing",
        "adapters.ros1.actions.states",
        "adapters.ros1.actions.wire",
        "adapters.ros1.names",
    },
    "adapters": {*TOOLS, "callers", "config", "kernels", "messages", "interfaces", "hub", "routing"},
    "metrics": {*TOOLS, "config", "daemon", "hub", "messages", "routing.counters"},
    "daemon": {*TOOLS, "config", "messages", "interfaces", "hub", "routing", "adapters"},
}
"""What each part of ``bridge`` may import beside itself; the command line, the doctor and the demo may import all."""


def imported(file: Path) -> set[str]:
    names = set[str]()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module)
        elif isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
    return {name.removeprefix("bridge.") for name in names if name.startswith("bridge.")}


@pytest.mark.parametrize("tool", sorted(TOOLS))
def test_the_tools_import_the_configuration_alone(tool: str) -> None:
    found = imported(ROOT / "bridge" / f"{tool}.py")
    assert not {name for name in found if name.partition(".")[0] not in {*TOOLS, "config"}}


@pytest.mark.parametrize("part", BELOW)
def test_imports_point_one_way(part: str) -> None:
    allowed = {part, *BELOW[part]}
    folder = ROOT / "bridge" / part
    inner = [ROOT / "bridge" / other for other in BELOW if other.startswith(f"{part}/")]
    wrong = {
        f"{file.relative_to(ROOT)} imports bridge.{name}"
        for file in folder.rglob("*.py")
        if not any(file.is_relative_to(other) for other in inner)
        for name in imported(file)
        if not any(name == good or name.startswith(good + ".") for good in allowed)
    }
    assert not wrong


SIDES = ("ros1", "ros2", "yarp", "zenoh")
OF_OTHERS = {"environment", "names"}
"""Of another side, which need nothing of its middleware: whether it can run here, and what its names become."""


@pytest.mark.parametrize("side", SIDES)
def test_no_side_reaches_into_another(side: str) -> None:
    others = [f"adapters.{other}" for other in SIDES if other != side]
    wrong = {
        f"{file.relative_to(ROOT)} imports {module}.{name}"
        for file in (ROOT / "bridge" / "adapters" / side).rglob("*.py")
        for module, name in named(file)
        for other in others
        if f"{module}.{name}".startswith(f"{other}.")
        and not any(f"{module}.{name}.".startswith(f"{other}.{part}.") for part in OF_OTHERS)
    }
    assert not wrong


def named(file: Path) -> set[tuple[str, str]]:
    """What a file imports of ``bridge``: module and name."""
    return {
        (node.module.removeprefix("bridge."), alias.name)
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("bridge.")
        for alias in node.names
    }


def test_the_simulator_stands_on_the_hub_the_module_host_and_yarp_compat() -> None:
    below = {"bridge.clock", "bridge.config", "bridge.hub", "bridge.messages", "bridge.modules", "bridge.stores"}
    allowed = {*below, "bridge.tf", "bridge.worker", "sim", "yarp_compat"}
    wrong = {
        f"{file.relative_to(ROOT)} imports {name}"
        for file in (ROOT / "sim").rglob("*.py")
        for name, _ in every_import(file)
        if name.split(".")[0] in ("bridge", "navigation", "yarp_compat", "tests")
        if not any(name == good or name.startswith(good + ".") for good in allowed)
    }
    assert not wrong


def test_navigation_stands_on_the_hub_the_store_and_the_module_host() -> None:
    below = {"bridge.clock", "bridge.config", "bridge.hub", "bridge.messages", "bridge.modules", "bridge.stores"}
    below |= {"bridge.concurrency", "bridge.kernels", "bridge.routing.stall", "bridge.routing.processes"}
    allowed = {*below, "bridge.tf", "bridge.worker", "navigation", "yarp_compat"}
    wrong = {
        f"{file.relative_to(ROOT)} imports {name}"
        for file in (ROOT / "navigation").rglob("*.py")
        for name, _ in every_import(file)
        if name.split(".")[0] in ("bridge", "sim", "yarp_compat", "tests", "rospy", "rclpy", "zenoh", "socket")
        if not any(name == good or name.startswith(good + ".") for good in allowed)
    }
    assert not wrong


_ARRAYS = ("sig", "dev", "octomap.py", "octree.py")
"""What of yarp_compat needs numpy; nothing else imports it."""


def test_yarp_compat_stands_alone() -> None:
    late = {"PIL", "yaml"}  # the files of maps
    allowed = sys.stdlib_module_names | {"yarp_compat", "numpy", *late}
    folder = ROOT / "yarp_compat"
    found = {(file.relative_to(folder), *found) for file in folder.rglob("*.py") for found in every_import(file)}
    wrong = {f"{file} imports {name}" for file, name, _ in found if name.split(".")[0] not in allowed}
    eager = {
        f"{file} imports {name}: where it is missing, the rest still works"
        for file, name, lazy in found
        if not lazy and (name.split(".")[0] in late or (name.split(".")[0] == "numpy" and file.parts[0] not in _ARRAYS))
    }
    assert found
    assert not wrong | eager


def every_import(file: Path) -> set[tuple[str, bool]]:
    """All names that a file imports, and whether it does so only when it comes to need them."""
    tree = ast.parse(file.read_text())
    at_once = {id(node) for node in _at_once(tree)}
    names = set[tuple[str, bool]]()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            names.add((node.module if node.level == 0 and node.module else "yarp_compat", id(node) not in at_once))
        elif isinstance(node, ast.Import):
            names.update((alias.name, id(node) not in at_once) for alias in node.names)
    return names


def _at_once(node: ast.AST) -> Iterator[ast.AST]:
    """What runs when a file is imported: not its functions, nor what is there for the type checker only."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            continue
        yield child
        yield from _at_once(child)
