"""A package in two versions, with renamed and retyped fields, and the rules that convert between the versions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

WHEEL, CALIBRATE, TURN = "fleet_msgs/msg/Wheel", "fleet_msgs/srv/Calibrate", "fleet_msgs/action/Turn"
OLD = {
    "msg/Wheel.msg": "string name\nfloat32 rpm\nint32 load\nfloat32[] past\nstring code\nSlip[] slips\n",
    "msg/Slip.msg": "int64 at\nbool bad\n",
    "srv/Calibrate.srv": "float32 target\n---\nfloat32 offset\n",
    "action/Turn.action": "float32 angle\n---\nint32 turns\n---\nfloat32 at\n",
}
NEW = {
    "msg/Wheel.msg": "string name\nfloat64 speed\nint16 load\nfloat64[] past\nint32 code\nSlip[] slips\nuint8 kind\n",
    "msg/Slip.msg": "uint8 bad\nfloat32 at\n",
    "srv/Calibrate.srv": "float64 goal\n---\nfloat64 offset\n",
    "action/Turn.action": "float64 radians\n---\nint32 turns\n---\nfloat64 at\n",
}
RULES: list[dict[str, Any]] = [
    {"message": WHEEL, "fields": {"rpm": "speed", "load": "load", "past": "past"}, "defaults": {"kind": 7}},
    {"message": WHEEL, "fields": {"code": "code"}},
    {"message": "fleet_msgs/msg/Slip", "fields": {"at": "at", "bad": "bad"}},
    {"message": f"{CALIBRATE}_Request", "fields": {"target": "goal"}},
    {"message": f"{CALIBRATE}_Response", "fields": {"offset": "offset"}},
    {"message": f"{TURN}_Goal", "fields": {"angle": "radians"}},
    {"message": f"{TURN}_Feedback", "fields": {"at": "at"}},
]


def write_package(folder: Path, files: Mapping[str, str]) -> None:
    """Write the files of a package (a mapping from path to text) into its folder."""
    for path, text in files.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


def write_versions(folder: Path) -> None:
    """Write the versions into the folders ``new`` and ``old``."""
    for name, files in (("new", NEW), ("old", OLD)):
        write_package(folder / name / "fleet_msgs", files)
