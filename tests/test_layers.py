"""Imports follow the layers of the design, without cycles."""

from __future__ import annotations

import ast
import functools
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from bridge.descriptors import ModuleDescriptor, WorkerDescriptor, all_modules, all_workers
from bridge.sides import Side, all_sides

ROOT = Path(__file__).parents[1]
TOOLS = {"clock", "concurrency", "descriptors", "progress", "registration", "resources", "shipped", "sides"}
TOOLS |= {"module_keys", "state_file", "state_machine", "status", "text", "ticks", "worker"}
"""Single modules next to the parts, which import only ``config`` and each other from ``bridge``."""

BELOW = {
    "config": {"descriptors", "messages", "registration", "sides"},
    "messages": set[str](),
    "tf": set(),
    "transform_server": {
        "tf",
        "client",
        "clock",
        "config",
        "descriptors",
        "hub",
        "messages",
        "modules",
        "status",
        "worker",
    },
    "interfaces": {"config", "messages"},
    "hub": {*TOOLS, "config", "messages"},
    "stores": {*TOOLS, "config", "hub"},
    "client": {
        *TOOLS,
        "config",
        "messages",
        "hub",
        "stores",
        "tf",
        "routing.counters",
        "routing.limits",
        "routing.rules",
    },
    "routing": {*TOOLS, "config", "messages", "hub"},
    "modules": {
        *TOOLS,
        "reconnecting_clients",
        "client",
        "config",
        "messages",
        "hub",
        "stores",
        "tf",
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
    "adapters": {*TOOLS, "reconnecting_clients", "config", "kernels", "messages", "interfaces", "hub", "routing"},
    "metrics": {*TOOLS, "config", "daemon", "hub", "messages", "routing.counters"},
    "daemon": {*TOOLS, "config", "messages", "interfaces", "hub", "routing", "adapters"},
}
"""Other parts that each part of ``bridge`` may import; the command line, the doctor and the demo may import all."""


Import = ast.Import | ast.ImportFrom


@functools.cache
def statements(file: Path) -> tuple[tuple[Import, bool], ...]:
    """Return a file's import statements, each with whether it is executed lazily, not when the file is imported."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    at_once = {id(node) for node in _at_once(tree)}
    return tuple((node, id(node) not in at_once) for node in ast.walk(tree) if isinstance(node, Import))


def imported(file: Path) -> set[str]:
    names = set[str]()
    for node, _ in statements(file):
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module)
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {name.removeprefix("bridge.") for name in names if name.startswith("bridge.")}


@pytest.mark.parametrize("tool", sorted(TOOLS))
def test_tools_import_only_the_configuration(tool: str) -> None:
    names = imported(ROOT / "bridge" / f"{tool}.py")
    assert not {name for name in names if name.partition(".")[0] not in {*TOOLS, "config"}}


DESCRIPTORS: tuple[WorkerDescriptor | Side | ModuleDescriptor, ...] = (
    *all_workers(),
    *all_sides(),
    *all_modules().values(),
)
CHECKS = {
    name.partition(":")[0]
    for each in DESCRIPTORS
    for name in (each.checks, *((each.cause, each.accepts) if isinstance(each, ModuleDescriptor) else ()))
    if name
}
"""The modules with a feature's code for the doctor, which its descriptor names; they belong to the doctor's layer."""


def files_of(folder: Path) -> list[Path]:
    """Return the Python files in a folder, without those that belong to the doctor's layer."""
    checks = {ROOT / f"{name.replace('.', '/')}.py" for name in CHECKS}
    return [file for file in folder.rglob("*.py") if file not in checks]


def test_only_the_doctor_imports_the_checks_of_features() -> None:
    assert {"bridge.web.checks", "navigation.gateway.checks", "navigation.map2d_server.checks"} <= CHECKS
    wrong = {
        f"{file.relative_to(ROOT)} imports {name}"
        for part in ("bridge", "navigation", "sim", "yarp_compat")
        for file in (ROOT / part).rglob("*.py")
        if not file.is_relative_to(ROOT / "bridge" / "doctor")
        for name in every_name(file)
        if name in CHECKS
    }
    assert not wrong


def every_name(file: Path) -> set[str]:
    """Return the modules that a file imports, and the names that it imports from modules."""
    names = {name for name, _ in every_import(file)}
    froms = (node for node, _ in statements(file) if isinstance(node, ast.ImportFrom))
    return names | {f"{node.module}.{alias.name}" for node in froms for alias in node.names}


@pytest.mark.parametrize("part", BELOW)
def test_parts_import_only_lower_parts(part: str) -> None:
    allowed = {part, *BELOW[part]}
    folder = ROOT / "bridge" / part
    wrong = {
        f"{file.relative_to(ROOT)} imports bridge.{name}"
        for file in files_of(folder)
        for name in imported(file)
        if not any(name == good or name.startswith(good + ".") for good in allowed)
    }
    assert not wrong


def test_only_the_command_line_imports_the_command_line() -> None:
    product = ("bridge", "navigation", "sim", "yarp_compat", "examples")
    files = (file for part in product for file in (ROOT / part).rglob("*.py"))
    wrong = {
        f"{file.relative_to(ROOT)} imports {name}"
        for file in files
        if not file.is_relative_to(ROOT / "bridge" / "cli")
        for name, _ in every_import(file)
        if name == "bridge.cli" or name.startswith("bridge.cli.")
    }
    assert not wrong


COMMANDS = ROOT / "bridge" / "cli"
OPEN = {f"bridge.{part}" for part in ("cli", "client", "config", "display", "messages", "state_file", "status", "text")}
OPEN |= {
    "bridge.module_keys",
    "bridge.tf",
    "bridge.stores.kinds",
    "navigation.nav2_errors",
    "navigation.status",
    "yarp_compat",
}
"""What every command may import: the client library, and the forms of configuration, documents and values."""

PASSED = {"bridge.hub.control.WorkerAnswer", "bridge.hub.graph.HubEndpoint", "bridge.hub.graph.releases"}
PASSED |= {"bridge.hub.wire.qos", "bridge.stores.entry", "bridge.stores.store.Write", "bridge.stores.store.THE_MAP"}
"""Values, with their functions, and errors that the client library accepts, returns or raises."""

BESIDE = {
    # its errors name what this machine's daemon lacks
    "client.py": {"bridge.daemon.units", "bridge.doctor.daemon_state"},
    # the first lines of a worker's process
    "child.py": {"bridge.daemon.heartbeat"},
    # processes of this machine, which these commands are, reload or query over the daemon's socket
    "daemon/run.py": {"bridge.daemon", "bridge.metrics.on_demand"},
    "daemon/record.py": {"bridge.record"},
    "daemon/reload.py": {"bridge.daemon.query", "bridge.doctor.daemon_state"},
    "daemon/sim.py": {"bridge.daemon.workers", "sim"},
    "daemon/web.py": {
        "bridge.daemon.query",
        "bridge.hub.security.external_router.key_files",
        "bridge.hub.security.tokens",
        "bridge.web.section",
    },
    "ros1": {"bridge.daemon.workers", "bridge.adapters.ros1.master.worker.state_file"},
    # a clock that also runs while the machine is suspended, after which no key counts as held
    "navigation/teleop.py": {"bridge.clock.steady"},
    # diagnoses from this machine's files and processes, and from the rules of its configuration
    "inspection": {"bridge.doctor"},
    "inspection/explain.py": {"bridge.routing.rules"},
    "navigation/gateway.py": {"bridge.doctor.hub_problems"},
    # files of this machine: bags, maps, keys, packages, services
    "bags": {"bridge.bags", "bridge.routing.rules.NameFilter"},
    "maps/files.py": {"bridge.stores.service"},
    "setup/keys.py": {"bridge.hub.security.certificates"},
    "setup/interfaces.py": {"bridge.interfaces"},
    "setup/install.py": {"bridge.daemon.install"},
    # algorithms on a map that the client library has received
    "maps": {"navigation"},
}
"""What the commands of a file or folder may also import, because it is not on the hub; comments give the reason."""


def commands() -> Iterator[tuple[str, str]]:
    """Yield each file of the command line with each name of the product, or of zenoh, that it imports."""
    for file in COMMANDS.rglob("*.py"):
        place = file.relative_to(COMMANDS).as_posix()
        names = {name for name, _ in every_import(file)}
        for node, _ in statements(file):
            if isinstance(node, ast.ImportFrom) and node.module:
                names.discard(node.module)
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
        yield from ((place, name) for name in names if name.split(".")[0] in _PRODUCT)


_PRODUCT = ("bridge", "navigation", "sim", "yarp_compat", "tests", "zenoh", "rospy", "rclpy")


def within(name: str, parts: Iterable[str]) -> bool:
    return any(f"{name}.".startswith(f"{part}.") for part in parts)


def is_listed(file: str, name: str, place: str, part: str) -> bool:
    return f"{file}/".startswith(f"{place}/") and within(name, [part])


def test_commands_import_only_the_client_library_and_what_is_listed_with_its_reason() -> None:
    beside = {(place, part) for place, parts in BESIDE.items() for part in parts}
    others = {(file, name) for file, name in commands() if not within(name, OPEN | PASSED)}
    uses = {(entry, use) for entry in beside for use in others if is_listed(*use, *entry)}
    wrong = others - {use for _, use in uses}
    assert not {f"bridge/cli/{file} imports {name}" for file, name in wrong}
    assert not beside - {entry for entry, _ in uses}, "nothing uses these permissions"


def test_commands_do_not_reach_through_the_client_library_to_the_hub() -> None:
    """They may pass ``client.hub`` to a part that joins the hub, but use nothing of it."""
    wrong = {
        f"bridge/cli/{file.relative_to(COMMANDS)}:{node.lineno} uses {ast.unparse(node)}"
        for file in COMMANDS.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute) and node.value.attr == "hub"
        if ast.unparse(node.value.value).rpartition(".")[2].strip("_") in ("client", "session", "node")
    }
    assert not wrong


CONSOLE = {
    "sources": set[str](),
    "serving": {"section"},
    "feeds": {"section", "sources"},
    "verbs": {"section", "sources"},
    "views": {"feeds", "section", "serving", "sources", "verbs"},
}
"""Other parts of the console that each of its parts may import."""


@pytest.mark.parametrize("part", CONSOLE)
def test_parts_of_the_console_import_only_lower_parts(part: str) -> None:
    allowed = {part, *CONSOLE[part]}
    wrong = {
        f"{file.relative_to(ROOT)} imports bridge.{name}"
        for file in (ROOT / "bridge" / "web" / part).rglob("*.py")
        for name in imported(file)
        if name.startswith("web.") and name.split(".")[1] not in allowed
    }
    assert not wrong


def test_programs_beside_rospy_import_only_what_the_system_has() -> None:
    """They run on the system's Python, with only this project's benchmarks and ``bridge`` on the path."""
    wrong = {
        f"{file.relative_to(ROOT)} imports {name}"
        for file in (ROOT / "benchmarks").rglob("*.py")
        if "rospy" in {name for name, _ in every_import(file)}
        for name, _ in every_import(file)
        if name.split(".")[0] in ("navigation", "sim", "yarp_compat", "typing_extensions")
    }
    assert not wrong


SIDES = ("ros1", "ros2", "yarp", "zenoh")
SHARED = {"environment", "names"}
"""Modules that other sides may import because they need no middleware: whether a side can run, and its names."""


@pytest.mark.parametrize("side", SIDES)
def test_sides_do_not_import_each_other(side: str) -> None:
    others = [f"adapters.{other}" for other in SIDES if other != side]
    wrong = {
        f"{file.relative_to(ROOT)} imports {module}.{name}"
        for file in (ROOT / "bridge" / "adapters" / side).rglob("*.py")
        for module, name in named(file)
        for other in others
        if f"{module}.{name}".startswith(f"{other}.")
        and not any(f"{module}.{name}.".startswith(f"{other}.{part}.") for part in SHARED)
    }
    assert not wrong


def named(file: Path) -> set[tuple[str, str]]:
    """Return what a file imports from ``bridge``: modules and names."""
    return {
        (node.module.removeprefix("bridge."), alias.name)
        for node, _ in statements(file)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("bridge.")
        for alias in node.names
    }


def test_the_simulator_imports_only_the_hub_the_module_host_and_yarp_compat() -> None:
    below = {"bridge.clock", "bridge.config", "bridge.hub", "bridge.messages", "bridge.modules", "bridge.stores"}
    allowed = {*below, "bridge.descriptors", "bridge.status", "bridge.tf", "bridge.worker", "sim", "yarp_compat"}
    wrong = {
        f"{file.relative_to(ROOT)} imports {name}"
        for file in (ROOT / "sim").rglob("*.py")
        for name, _ in every_import(file)
        if name.split(".")[0] in ("bridge", "navigation", "yarp_compat", "tests")
        if not any(name == good or name.startswith(good + ".") for good in allowed)
    }
    assert not wrong


def test_navigation_imports_only_the_hub_its_clients_the_store_and_the_module_host() -> None:
    below = {"bridge.clock", "bridge.config", "bridge.hub", "bridge.messages", "bridge.modules", "bridge.stores"}
    below |= {
        "bridge.client",
        "bridge.concurrency",
        "bridge.kernels",
        "bridge.module_keys",
        "bridge.state_machine",
        "bridge.status",
        "bridge.routing.hold",
        "bridge.routing.stall",
        "bridge.routing.processes",
    }
    allowed = {*below, "bridge.descriptors", "bridge.tf", "bridge.worker", "navigation", "yarp_compat"}
    wrong = {
        f"{file.relative_to(ROOT)} imports {name}"
        for file in files_of(ROOT / "navigation")
        for name, _ in every_import(file)
        if name.split(".")[0] in ("bridge", "sim", "yarp_compat", "tests", "rospy", "rclpy", "zenoh", "socket")
        if not any(name == good or name.startswith(good + ".") for good in allowed)
    }
    assert not wrong


_ARRAYS = ("sig", "dev", "octomap.py", "octree.py")
"""The parts of yarp_compat that need numpy; no others import it."""


def test_yarp_compat_imports_nothing_of_midspan() -> None:
    late = {"PIL", "yaml", "typing_extensions"}  # for map files, and for the type checker
    allowed = sys.stdlib_module_names | {"yarp_compat", "numpy", *late}
    folder = ROOT / "yarp_compat"
    imports = {(file.relative_to(folder), *entry) for file in folder.rglob("*.py") for entry in every_import(file)}
    wrong = {f"{file} imports {name}" for file, name, _ in imports if name.split(".")[0] not in allowed}
    eager = {
        f"{file} imports {name} at import time; it is optional, so import it in the function that needs it"
        for file, name, lazy in imports
        if not lazy and (name.split(".")[0] in late or (name.split(".")[0] == "numpy" and file.parts[0] not in _ARRAYS))
    }
    assert imports
    assert not wrong | eager


def every_import(file: Path) -> set[tuple[str, bool]]:
    """Return the modules that a file imports, each with whether it is imported lazily."""
    names = set[tuple[str, bool]]()
    for node, lazy in statements(file):
        if isinstance(node, ast.ImportFrom):
            names.add((node.module if node.level == 0 and node.module else "yarp_compat", lazy))
        else:
            names.update((alias.name, lazy) for alias in node.names)
    return names


def _at_once(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that run when a file is imported: no functions, and nothing for the type checker only."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            continue
        yield child
        yield from _at_once(child)


_ROS1 = {"rospy", "rosgraph", "genpy", "roslib", "rosmaster"}
_ROS1_PROGRAMS = {ROOT / "bridge" / "demo" / "topics_demo" / "robot.py"}
"""The demo's robot is a ROS 1 program."""


def test_only_the_demos_robot_imports_packages_of_ros1() -> None:
    files = {file for part in ("bridge", "navigation", "yarp_compat", "sim") for file in (ROOT / part).rglob("*.py")}
    wrong = {
        f"{file.relative_to(ROOT)} imports {name}"
        for file in files - _ROS1_PROGRAMS
        for name, _ in every_import(file)
        if name.split(".")[0] in _ROS1
    }
    assert not wrong
