"""The files generated from the model are correct and up to date, and the shipped configurations are valid."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from bridge.boards.section import ControlBoardSection
from bridge.config import generate
from bridge.config.load import load, loads
from bridge.config.model import Config
from bridge.config.problems import all_keys
from bridge.config.sections.modules import OwnModule
from bridge.config.sections.navigation import Planner
from bridge.config.sections.obstacles import ObstacleSection
from bridge.config.sections.routing import ParameterRule, QosOverride, Rule
from bridge.config.sections.yarp import ServicePort, TopicPort
from bridge.config.sections.zenoh import Dialect, DialectKey
from bridge.web.section import OtherRobot
from navigation.base_control.section import BaseInput
from navigation.mapper3d.section import DepthSource

ROOT = Path(__file__).parents[2]
ENTRIES = (
    Rule, ParameterRule, QosOverride, Dialect, DialectKey, TopicPort, ServicePort, OwnModule, BaseInput, Planner,
    OtherRobot, ControlBoardSection, ObstacleSection, DepthSource,
)  # fmt: skip
"""Sections that are entries of lists."""
CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))


def test_example_has_every_key_and_loads_to_the_defaults() -> None:
    text = generate.example()
    assert loads(text) == Config()
    data: dict[str, Any] = YAML(typ="safe").load(text)
    for path in all_keys(Config):
        part: Any = data
        if path == ("name",):
            assert "\n# name:\n" in text  # the default is this machine's name, which would be wrong on other machines
            continue
        lists = (
            ("routing", "rules"),
            ("routing", "parameters"),
            ("zenoh", "dialects"),
            ("yarp", "topics"),
            ("yarp", "peers"),
            ("yarp", "services"),
            ("modules", "own"),
            ("modules", "base_control", "inputs"),
            ("modules", "control_boards", "boards"),
            ("modules", "map2d_server", "take"),
            ("modules", "mapper3d", "depth"),
            ("modules", "robot_goto", "obstacles"),
            ("modules", "robot_path_planner", "obstacles"),
            ("navigation", "planners"),
            ("web", "robots"),
        )
        if any(path[: len(inner)] == inner != path for inner in lists):
            continue
        for key in path:
            part = part[key]
    for model in ENTRIES:
        for name, info in model.model_fields.items():
            assert f"- {info.alias or name} (" in text
    assert max(len(line) for line in text.splitlines()) <= generate.WIDTH


def test_every_key_is_described() -> None:
    def check(model: Any) -> None:
        for name, info in model.model_fields.items():
            assert info.description, f"{model.__name__}.{name}"

    sections = (type(getattr(Config(), name)) for name in Config.model_fields)
    for model in (Config, *ENTRIES, *sections):
        if hasattr(model, "model_fields"):
            check(model)


@pytest.mark.parametrize("file", CONFIGS, ids=lambda file: file.name)
def test_shipped_configurations_are_valid(file: Path) -> None:
    load(file)
    assert file.read_text(encoding="utf-8").startswith(f"# yaml-language-server: $schema={generate.SCHEMA_FILE}\n")


def test_default_configuration_changes_no_default() -> None:
    assert load(ROOT / "configs" / "default.yaml") == Config()


def test_schema_is_up_to_date_and_names_the_keys_of_the_file() -> None:
    text = (ROOT / "configs" / generate.SCHEMA_FILE).read_text()
    assert text == generate.schema(), "midspan config schema > configs/midspan.schema.json"
    schema = json.loads(text)
    assert schema["additionalProperties"] is False
    assert "from" in schema["$defs"]["Rule"]["properties"]


def test_reference_page_is_up_to_date() -> None:
    assert (ROOT / "docs" / "operate" / "config.md").read_text() == generate.reference(), (
        "midspan config reference > docs/operate/config.md"
    )
