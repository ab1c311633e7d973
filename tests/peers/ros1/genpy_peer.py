"""Converts sample messages with the real genpy; run by the system's Python.

Reads one JSON list from standard input: ``{"type", "definition", "values", "ros1"}`` with the fields' values in ROS
2's naming and the base64 bytes that were converted; a service's request is of type ``pkg/srv/Name_Request``. Writes for
each ``{"md5", "bytes", "same"}``: genpy's md5, its own bytes of the same values, and whether it reads the converted
bytes as the same message; or ``{"error"}``.
"""

import base64
import importlib
import io
import json
import sys

import genpy
import genpy.dynamic

MADE = {}


def message_class(name, definition):
    package, *kind, short = name.split("/")
    if kind:
        service, _, part = short.rpartition("_")
        return getattr(importlib.import_module(f"{package}.srv"), service + part)
    try:
        return getattr(importlib.import_module(f"{package}.msg"), short)
    except (ImportError, AttributeError):
        MADE.update(genpy.dynamic.generate_dynamic(name, definition))
        return MADE[name]


def fill(message, values):
    slots = {slot.lower(): slot for slot in message.__slots__}
    for name, value in values.items():
        slot = slots.get(name.lower())
        if slot is None:
            continue
        kind = message._slot_types[message.__slots__.index(slot)]
        setattr(message, slot, convert(kind, value))
    return message


def convert(kind, value):
    if kind.endswith("]"):
        base = kind.split("[")[0]
        if base in ("uint8", "char"):
            return bytes(value)
        return [convert(base, item) for item in value]
    if kind == "time":
        return genpy.Time(value["sec"], value["nanosec"])
    if kind == "duration":
        return genpy.Duration(value["sec"], value["nanosec"])
    if "/" in kind:
        cls = genpy.message.get_message_class(kind) or MADE[kind]
        return fill(cls(), value)
    return value


def answer(item):
    cls = message_class(item["type"], item["definition"])
    message = fill(cls(), item["values"])
    buffer = io.BytesIO()
    message.serialize(buffer)
    read = cls().deserialize(base64.b64decode(item["ros1"]))
    return {
        "md5": cls._md5sum,
        "bytes": base64.b64encode(buffer.getvalue()).decode(),
        "same": str(read) == str(message),
    }


def main():
    answers = []
    for item in json.load(sys.stdin):
        try:
            answers.append(answer(item))
        except Exception as err:
            answers.append({"error": repr(err)})
    json.dump(answers, sys.stdout)


main()
