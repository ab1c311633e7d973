"""Writes and reads ROS 1 bags with ROS 1's ``rosbag``; needs only the system's Python.

``bag.py write`` reads ``{file: [[topic, type, definition, values], ...], ...}`` from standard input.
``bag.py read FILE...`` prints ``[[[topic, type, values], ...], ...]``, with the error in place of a file's list.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import genpy
import rosbag
import yaml
from genpy.dynamic import generate_dynamic

START = 1_700_000_000


def write(file: str, messages: list[tuple[str, str, str, Any]]) -> None:
    with rosbag.Bag(file, "w") as bag:
        for number, (topic, type_name, definition, values) in enumerate(messages):
            message = generate_dynamic(type_name, definition)[type_name]()
            genpy.message.fill_message_args(message, [values])
            bag.write(topic, message, genpy.Time(START + number))


def read(file: str) -> list[tuple[str, str, Any]] | str:
    try:
        with rosbag.Bag(file) as bag:
            return [(topic, message._type, yaml.safe_load(str(message))) for topic, message, _ in bag.read_messages()]
    except Exception as err:
        return f"{type(err).__name__}: {err}"


if sys.argv[1] == "write":
    for name, contents in json.load(sys.stdin).items():
        write(name, contents)
else:
    json.dump([read(name) for name in sys.argv[2:]], sys.stdout)
