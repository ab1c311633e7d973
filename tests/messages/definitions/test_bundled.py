"""The definitions that come with Midspan, for machines without ROS 2."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from bridge.messages import actions
from bridge.messages.definitions.hashes import rihs01
from bridge.messages.definitions.stores import read_store
from bridge.messages.registry import Registry
from tests.support.missing import ROS2, needs

ROOT = Path(__file__).parents[3]
BUNDLED = ROOT / "bridge" / "messages" / "definitions" / "ros2"
SERVICES = sorted(f"{file.parts[-3]}/srv/{file.stem}" for file in BUNDLED.rglob("*.srv"))
NAMED = re.compile(r'"([a-z][a-z0-9_]*/(?:msg|srv|action)/[A-Z][A-Za-z0-9]*)"')


@pytest.fixture
def without_ros2(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """A registry on a machine without ROS 2 packages."""
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.setattr(sys, "prefix", "/nowhere")
    return Registry()


def test_types_of_modules_are_known_without_ros2(without_ros2: Registry) -> None:
    """All types that the code of the modules names are known."""
    text = "".join(file.read_text() for folder in ("navigation", "sim") for file in (ROOT / folder).rglob("*.py"))
    names = {actions.CANCEL, actions.STATUSES, *NAMED.findall(text)}
    assert len(names) > 20
    for name in names:
        if "/srv/" in name:
            assert without_ros2.service_schemas(name)
        else:
            assert without_ros2.schema(name)


@needs(ROS2)
@pytest.mark.parametrize("name", SERVICES)
def test_hashes_are_those_of_ros2(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    native = [rihs01(schema) for schema in Registry().service_schemas(name)]
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.setattr(sys, "prefix", "/nowhere")
    assert [rihs01(schema) for schema in Registry().service_schemas(name)] == native


@needs(ROS2)
def test_default_values_are_those_of_ros2(without_ros2: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    def defaults(registry: Registry) -> dict[str, list[object]]:
        schemas = {name: registry.schema(name) for name in read_store("ros2_jazzy") if "/msg/" in name}
        return {name: [field.default or None for field in schema.root.fields] for name, schema in schemas.items()}

    bundled = defaults(without_ros2)
    assert bundled["geometry_msgs/msg/Quaternion"] == [None, None, None, 1.0]
    monkeypatch.undo()
    assert defaults(Registry()) == bundled
