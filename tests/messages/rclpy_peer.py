"""Run by the venv's Python: what real rclpy makes of sample messages.

Reads one JSON list from standard input: ``{"type", "values", "cdr"}`` with the base64 bytes that were made here. Writes
for each ``{"bytes", "same"}``: rclpy's own bytes of the same values (with the slack that it leaves behind them), and
whether it reads the given bytes as the same message; ``{"missing"}`` where it has no such type; or ``{"error"}``.
"""

from __future__ import annotations

import array
import base64
import importlib
import json
import sys
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message


def fill(message: Any, values: dict[str, Any]) -> Any:
    for name, value in values.items():
        setattr(message, name, convert(getattr(message, name), message.get_fields_and_field_types()[name], value))
    return message


def convert(now: Any, kind: str, value: Any) -> Any:
    if isinstance(now, np.ndarray):
        return np.array(value, now.dtype)
    if isinstance(now, array.array):
        return array.array(now.typecode, value)
    if kind == "octet":
        return bytes([value])
    if isinstance(value, list):
        element = kind.removeprefix("sequence<").split("[")[0].split(",")[0].rstrip(">")
        if element == "octet":
            return [bytes([item]) for item in value]
        if "/" in element:
            return [fill(message_class(element)(), item) for item in value]
        return value
    if isinstance(value, dict):
        return fill(now, value)
    return value


def message_class(name: str) -> Any:
    parts = name.split("/")
    return getattr(importlib.import_module(f"{parts[0]}.msg"), parts[-1])


def answer(item: dict[str, Any]) -> dict[str, Any]:
    try:
        cls = message_class(item["type"])
    except (ImportError, AttributeError):
        return {"missing": True}
    message = fill(cls(), item["values"])
    read = deserialize_message(base64.b64decode(item["cdr"]), cls)
    return {"bytes": base64.b64encode(serialize_message(message)).decode(), "same": read == message}


def main() -> None:
    answers = []
    for item in json.load(sys.stdin):
        try:
            answers.append(answer(item))
        except Exception as err:
            answers.append({"error": repr(err)})
    json.dump(answers, sys.stdout)


main()
