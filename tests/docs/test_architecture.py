"""Every path, class and method in ARCHITECTURE.md exists, and the paths of a message and a goal stay short."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import pytest

from bridge.daemon import worker_states
from bridge.routing.hub_end import DEMAND, Demand, DemandEvent
from navigation.gateway import machine
from navigation.robot_goto.machine import DRIVER, DriverEvent, DriverState
from scripts import house

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
WORDS = sorted(set(re.findall(r"`([^`\s<>]+)`", PAGE)))
PATHS = [name for name in WORDS if "/" in name and not name.startswith("/")]
NAMES = [name for name in WORDS if re.fullmatch(r"[A-Z]\w*(\.\w+)?", name)]
NUMBERED = re.findall(r"^\| *\d+ *\|.*", PAGE, re.MULTILINE)
ROWS = re.findall(r"^\| *\d+ *\| `([\w/]+\.py)` \| `([\w.]+)` \|", PAGE, re.MULTILINE)
"""File and method of each row in the tables that describe a path."""


@pytest.mark.parametrize("path", PATHS)
def test_every_path_of_the_page_exists(path: str) -> None:
    assert (ROOT / path).exists()


@pytest.fixture(scope="module")
def classes() -> dict[str, set[str]]:
    """Return the page's classes by name, with their methods; only files that contain one are parsed."""
    kinds = "|".join({name.partition(".")[0] for name in NAMES})
    result: dict[str, set[str]] = {}
    for package in house.PRODUCT:
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if not re.search(rf"^\s*class ({kinds})\b", text, re.MULTILINE):
                continue
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.ClassDef):
                    methods = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
                    result[node.name] = result.get(node.name, set()) | methods
    return result


@pytest.mark.parametrize("name", NAMES)
def test_every_class_and_method_of_the_page_exists(name: str, classes: dict[str, set[str]]) -> None:
    kind, _, method = name.partition(".")
    assert kind in classes
    assert not method or method in classes[kind]


def defines(body: Sequence[ast.stmt], name: str) -> bool:
    """Return whether statements define a name: a function, a class, or ``Class.method``."""
    first, _, member = name.partition(".")
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name == first and not member:
            return True
        if isinstance(node, ast.ClassDef) and node.name == first:
            return not member or defines(node.body, member)
    return False


@pytest.mark.parametrize(("file", "name"), ROWS)
def test_each_row_names_a_method_of_its_file(file: str, name: str) -> None:
    assert defines(ast.parse((ROOT / file).read_text(encoding="utf-8")).body, name)


def test_every_numbered_row_names_a_file_and_a_method() -> None:
    assert len(ROWS) == len(NUMBERED) > 40


def test_there_are_paths_and_names() -> None:
    assert len(PATHS) > 40
    assert len(NAMES) > 10


def test_the_path_of_a_scan_is_short() -> None:
    assert 0 < house.described_paths(ROOT)["The path of a message"] <= 9


def test_the_path_of_a_goal_is_short() -> None:
    assert 0 < house.described_paths(ROOT)["The path of a goal"] <= 15


def diagram(table: Mapping[Any, Mapping[Any, Any]], first: Enum, without: frozenset[str] = frozenset()) -> str:
    """Return a table of transitions as a Mermaid state diagram."""
    lines = ["```mermaid", "stateDiagram-v2", f"    [*] --> {first.name}"]
    for state, row in table.items():
        events: dict[Enum, list[str]] = {}
        for event, following in row.items():
            if event.name not in without:
                events.setdefault(following, []).append(event.name.lower())
        lines += [f"    {state.name} --> {following.name}: {', '.join(names)}" for following, names in events.items()]
    return "\n".join([*lines, "```"])


@pytest.mark.parametrize(
    "drawn",
    [
        diagram(machine.PLANNER, machine.PlannerState.UNKNOWN),
        diagram(machine.DRIVE, machine.DriveState.WAITING, frozenset(("PAUSE", "STOP", "END"))),
        diagram(machine.STOP, machine.StopState.NONE),
        diagram(machine.VELOCITY, machine.VelocityState.SILENT),
        diagram(machine.SENDER, machine.SenderState.SILENT, frozenset(("END",))),
        diagram(DRIVER, DriverState.IDLE, frozenset(("GOAL", "BACK_OFF", "APPROACH", "CANCEL"))),
        diagram(DEMAND, Demand.UNWANTED),
    ],
    ids=["planner", "drive", "stop", "velocity", "sender", "robot_goto", "demand"],
)
def test_the_state_diagrams_match_their_tables(drawn: str) -> None:
    assert drawn in PAGE, f"ARCHITECTURE.md must contain:\n{drawn}"


@pytest.mark.parametrize(
    "event",
    [
        *machine.PlannerEvent,
        *machine.DriveEvent,
        *machine.StopEvent,
        *machine.VelocityEvent,
        *machine.SenderEvent,
        *DriverEvent,
        *DemandEvent,
    ],
    ids=lambda event: f"{type(event).__name__}-{event.name.lower()}",
)
def test_the_tables_of_events_have_each_event_with_its_meaning(event: Enum) -> None:
    row = f"| `{event.name.lower()}` | {event.value} |"
    assert row in PAGE.splitlines(), f"ARCHITECTURE.md must contain:\n{row}"


_STATES = {
    worker_states.IDLE: "all without a process",
    frozenset(worker_states.Phase) - {worker_states.Phase.STOPPING}: "all except STOPPING",
    frozenset(worker_states.Phase): "all",
}


@pytest.mark.parametrize("event", worker_states.WorkerEvent, ids=lambda event: event.name.lower())
def test_the_table_of_a_workers_states_has_each_event(event: worker_states.WorkerEvent) -> None:
    states, following = worker_states.TRANSITIONS[event]
    names = _STATES.get(states) or ", ".join(state.name for state in worker_states.Phase if state in states)
    row = f"| `{event.name.lower()}` | {event.value} | {names} | {following.name} |"
    assert row in PAGE.splitlines(), f"ARCHITECTURE.md must contain:\n{row}"


@pytest.mark.parametrize("state", worker_states.Phase, ids=lambda state: state.name.lower())
def test_the_table_of_a_workers_states_has_each_state(state: worker_states.Phase) -> None:
    assert f"\n| {state.name} | {state.value} |" in PAGE
