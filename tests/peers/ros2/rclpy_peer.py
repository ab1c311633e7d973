"""Encodes and decodes sample messages with real rclpy; run by the virtual environment's Python.

Reads one JSON list from standard input, and writes a list with one reply for each item:

- ``{"type", "values", "cdr"}``, with the test's bytes in base64: ``{"bytes", "same"}``, which are rclpy's own bytes for
  the values (including trailing padding), and whether rclpy decodes the test's bytes to the same message;
- ``{"hash"}``, the name of a service, an action or a service of an action: ``{"hash"}``, its hash in rclpy;
- ``{"missing"}`` for an unknown type, ``{"error"}`` for a failure.
"""

from __future__ import annotations

import array
import base64
import ctypes
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
    package, *kind, short = name.split("/")
    if kind in ([], ["msg"]):
        return getattr(importlib.import_module(f"{package}.msg"), short)
    base, *parts = short.split("_")
    interface = getattr(importlib.import_module(f"{package}.{kind[0]}"), base)
    if len(parts) == 2:
        interface, parts = getattr(interface.Impl, f"{parts[0]}Service"), parts[1:]
    return getattr(interface.Impl if parts == ["FeedbackMessage"] else interface, parts[0])


def type_hash(name: str) -> str:
    """Return the hash from the C type support, a structure with a pointer to the function that returns the hash."""
    package, kind, short = name.split("/")
    base, _, part = short.partition("_")
    interface = getattr(importlib.import_module(f"{package}.{kind}"), base)
    if part:
        interface = getattr(interface.Impl, f"{part}Service")
    interface.__class__.__import_type_support__()
    ctypes.pythonapi.PyCapsule_GetPointer.restype = ctypes.c_void_p
    ctypes.pythonapi.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    support = ctypes.pythonapi.PyCapsule_GetPointer(interface._TYPE_SUPPORT, None)
    members = ctypes.cast(support, ctypes.POINTER(ctypes.c_void_p))
    get = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(members[5 if kind == "action" and not part else 8] or 0)
    version, *value = ctypes.string_at(get(support) or 0, 33)
    return f"RIHS{version:02}_{bytes(value).hex()}"


def answer(item: dict[str, Any]) -> dict[str, Any]:
    if "hash" in item:
        return {"hash": type_hash(item["hash"])}
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
