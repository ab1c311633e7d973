"""The tables of rosbags' type stores, read without importing their message classes."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys

import pytest

from bridge.messages.definitions.stores import read_store


@pytest.mark.parametrize("store", ["ros1_noetic", "ros2_jazzy"])
def test_a_table_equals_that_of_the_imported_store(store: str) -> None:
    table = importlib.import_module(f"rosbags.typesys.stores.{store}").FIELDDEFS
    assert read_store(store) == table
    assert len(table) > 100


def test_the_stores_and_their_classes_are_not_imported() -> None:
    """Every worker reads the tables at its start."""
    program = (
        "import dataclasses, json, sys\n"
        "from bridge.messages.definitions import sources\n"
        "from bridge.messages.definitions.schema import World\n"
        "made = []\n"
        "dataclasses._process_class = lambda cls, *_: made.append(cls.__name__)\n"
        "found = [sources.find_in_store('std_msgs/msg/String', World.ROS2) is not None,\n"
        "         sources.find_in_store('std_msgs/String', World.ROS1) is not None]\n"
        "print(json.dumps([found, made, [name for name in sys.modules if name.startswith('rosbags.typesys')]]))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    found, made, modules = json.loads(run.stdout)
    assert found == [True, True]
    assert modules == []
    assert not [name for name in made if "__msg__" in name]
