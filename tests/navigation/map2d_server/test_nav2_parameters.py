"""Nav2's parameters for keep-out areas in the docs: the filters exist, and their areas are inflated."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[3]
FOLDERS = ("docs", "configs", "examples")

# nav2_costmap_2d, branch jazzy: src/costmap_2d_ros.cpp, plugins/costmap_filters/*.cpp, plugins/inflation_layer.cpp
_FILTER = {"plugin", "enabled", "filter_info_topic", "transform_tolerance"}
_INFLATION = {"inflation_radius", "cost_scaling_factor", "inflate_unknown", "inflate_around_unknown"}
KNOWN = {
    "nav2_costmap_2d::KeepoutFilter": {*_FILTER, "override_lethal_cost", "lethal_override_cost"},
    "nav2_costmap_2d::SpeedFilter": {*_FILTER, "speed_limit_topic"},
    "nav2_costmap_2d::InflationLayer": {"plugin", "enabled", *_INFLATION},
}


def snippets() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the parameters of each costmap in all pages and files, with the names of file and costmap."""
    for folder in FOLDERS:
        for file in sorted([*(ROOT / folder).rglob("*.md"), *(ROOT / folder).rglob("*.yaml")]):
            text = file.read_text()
            blocks = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL) if file.suffix == ".md" else [text]
            for block in (block for block in blocks if "costmap:" in block and "filters:" in block):
                for name, costmap in yaml.safe_load(block).items():
                    yield f"{file.name} {name}", costmap[name]["ros__parameters"]


SNIPPETS = dict(snippets())


def test_both_costmaps_are_shown() -> None:
    assert {"maps.md global_costmap", "maps.md local_costmap"} <= SNIPPETS.keys()


@pytest.mark.parametrize("name", SNIPPETS)
def test_keep_out_areas_are_inflated(name: str) -> None:
    parameters = SNIPPETS[name]
    filters = [parameters[key] for key in parameters["filters"]]
    for section in filters:
        assert section.keys() <= KNOWN[section["plugin"]]
    plugins = [section["plugin"].removeprefix("nav2_costmap_2d::") for section in filters]
    assert plugins[0] == "KeepoutFilter"
    assert plugins[-1] == "InflationLayer", "a layer before the filters does not see their areas"
    assert filters[-1]["inflation_radius"] > 0.0
