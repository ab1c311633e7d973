"""ROS 1 to CDR and back: Midspan's converters compared with rosbags', in one process, in turns.

Bulk messages are also compared with a bare copy of their bytes. Conversions between two releases of ROS 2 are compared
with a checked copy of the message by the same virtual machine. Each figure is the time of one conversion, as the median
over the rounds.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, report
from bridge.adapters.memory import keep_memory
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from bridge.messages.transcode.compiler import compile_check
from bridge.messages.transcode.conversion import make_vm
from bridge.messages.values import MessageWriter

BULK = 500_000
"""Minimum size in bytes of the messages that are compared with a bare copy."""

SECONDS_A_ROUND = 0.02


def transforms(count: int) -> dict[str, Any]:
    """Return the values of a TFMessage."""
    rotation = {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}
    moves = [
        {
            "header": {"stamp": {"sec": 100 + k, "nanosec": k}, "frame_id": "base_link"},
            "child_frame_id": f"link_{k}",
            "transform": {"translation": {"x": k + 0.5, "y": 1.0, "z": 2.0}, "rotation": rotation},
        }
        for k in range(count)
    ]
    return {"transforms": moves}


def diagnostics(count: int, values: int) -> dict[str, Any]:
    """Return the values of a DiagnosticArray."""
    keys = [{"key": f"temperature of part {k}", "value": f"{20 + k} degrees"} for k in range(values)]
    status = [
        {
            "level": k % 3,
            "name": f"motor_{k}: drive",
            "message": "running well",
            "hardware_id": f"hw{k}",
            "values": keys,
        }
        for k in range(count)
    ]
    return {"status": status}


def joints(count: int) -> dict[str, Any]:
    """Return the values of a JointState."""
    numbers = [0.1 * k for k in range(count)]
    names = [f"arm_{k}_joint" for k in range(count)]
    return {"header": {"frame_id": "base"}, "name": names, "position": numbers, "velocity": numbers, "effort": numbers}


def image(width: int, height: int) -> dict[str, Any]:
    """Return the values of an rgb8 Image."""
    content = bytes(range(256)) * (3 * width * height // 256)
    return {"header": {"frame_id": "camera"}, "width": width, "height": height, "encoding": "rgb8", "data": content}


def goals(count: int) -> dict[str, Any]:
    """Return the values of a GoalStatusArray."""
    status = [{"goal_id": {"id": f"/client-{k}-1700000000.25"}, "status": 3, "text": "reached"} for k in range(count)]
    return {"status_list": status}


def cloud(points: int) -> dict[str, Any]:
    """Return the values of a PointCloud2 with points of 16 bytes."""
    fields = [{"name": name, "offset": 4 * k, "datatype": 7, "count": 1} for k, name in enumerate("xyz")]
    content = bytes(range(256)) * (points // 16)
    return {"header": {"frame_id": "lidar"}, "width": points, "height": 1, "fields": fields, "data": content}


SCAN = {"header": {"frame_id": "laser"}, "ranges": [0.5 + k / 720 for k in range(720)], "intensities": [1.0] * 720}
GRID = {"info": {"width": 1000, "height": 1000, "resolution": 0.05}, "data": [k % 101 - 1 for k in range(1_000_000)]}
CASES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "String 100 B": ("std_msgs/msg/String", {"data": "a" * 100}),
    "Twist": ("geometry_msgs/msg/Twist", {"linear": {"x": 0.2}, "angular": {"z": 0.4}}),
    "TFMessage of 20": ("tf2_msgs/msg/TFMessage", transforms(20)),
    "LaserScan 720": ("sensor_msgs/msg/LaserScan", SCAN),
    "OccupancyGrid 1000x1000": ("nav_msgs/msg/OccupancyGrid", GRID),
    "Image 1 MB": ("sensor_msgs/msg/Image", image(640, 520)),
    "Image 6 MB": ("sensor_msgs/msg/Image", image(1920, 1080)),
    "PointCloud2 of 65536": ("sensor_msgs/msg/PointCloud2", cloud(65536)),
    "Float64MultiArray 1 MB": ("std_msgs/msg/Float64MultiArray", {"data": [k / 8 for k in range(131072)]}),
    "JointState of 50": ("sensor_msgs/msg/JointState", joints(50)),
    "DiagnosticArray 20x10": ("diagnostic_msgs/msg/DiagnosticArray", diagnostics(20, 10)),
    "GoalStatusArray of 20": ("actionlib_msgs/msg/GoalStatusArray", goals(20)),
    "Path of 100": ("nav_msgs/msg/Path", {"poses": [{"header": {"frame_id": "map"}}] * 100}),
}


POSES = [{"header": {"frame_id": "map"}, "pose": {"position": {"x": k / 8}}} for k in range(100)]
RELEASES: dict[str, tuple[str, dict[str, Any]]] = {
    "NavigateToPose feedback": (
        "nav2_msgs/action/NavigateToPose_FeedbackMessage",
        {"feedback": {"current_pose": POSES[1], "distance_remaining": 2.5}},
    ),
    "NavigateThroughPoses, 100 poses": ("nav2_msgs/action/NavigateThroughPoses_SendGoal", {"goal": {"poses": POSES}}),
    "FollowPath, 100 poses": (
        "nav2_msgs/action/FollowPath_SendGoal",
        {"goal": {"path": {"poses": POSES}, "controller_id": "FollowPath"}},
    ),
}
"""Messages whose fields differ between Jazzy and another release; for a service, its request."""


def compare(ours: Callable[[], object], peer: Callable[[], object], rounds: int) -> tuple[float, float]:
    """Return the median duration of a call of each function, in microseconds; each runs first in every other round."""
    calls = [max(1, int(SECONDS_A_ROUND / max(_time(call, 3), 1e-7))) for call in (ours, peer)]
    times: list[list[float]] = [[], []]
    for number in range(rounds):
        for which in (0, 1) if number % 2 == 0 else (1, 0):
            times[which].append(_time((ours, peer)[which], calls[which]))
    return 1e6 * statistics.median(times[0]), 1e6 * statistics.median(times[1])


def _time(call: Callable[[], object], times: int) -> float:
    start = time.perf_counter()
    for _ in range(times):
        call()
    return (time.perf_counter() - start) / times


def measure_case(case: str, name: str, values: Mapping[str, Any], rounds: int) -> list[Row]:
    """Measure one message, and return the rows."""
    registry = Registry()
    store = get_typestore(Stores.ROS2_JAZZY)
    cdr = from_json(registry, name, values)
    back = registry.hub_to_ros1(name)
    to_ros1, to_cdr = back.convert, registry.ros1_to_hub(back.target.name).convert
    assert to_ros1 is not None
    assert to_cdr is not None
    ros1 = to_ros1(cdr)
    if to_cdr(ros1) != cdr or bytes(store.ros1_to_cdr(ros1, name)) != cdr:
        msg = f"{case}: the two conversions differ"
        raise SystemExit(msg)
    pairs: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
        "ROS 1 to CDR, rosbags": (lambda: to_cdr(ros1), lambda: store.ros1_to_cdr(ros1, name)),
        "CDR to ROS 1, rosbags": (lambda: to_ros1(cdr), lambda: store.cdr_to_ros1(cdr, name)),
    }
    if len(cdr) >= BULK:
        source1, source2 = bytearray(ros1), bytearray(cdr)
        pairs["ROS 1 to CDR, bare copy"] = (lambda: to_cdr(ros1), lambda: bytes(source1))
        pairs["CDR to ROS 1, bare copy"] = (lambda: to_ros1(cdr), lambda: bytes(source2))
    return [Row(f"{case}, {direction}", *compare(*calls, rounds), "us") for direction, calls in pairs.items()]


def measure_release(case: str, name: str, values: Mapping[str, Any], rounds: int) -> list[Row]:
    """Measure one message between Jazzy and the newest release with other fields; return the rows."""
    registry = Registry()
    releases, here, part = registry.releases, registry.schema(name), "Request" if name.endswith("SendGoal") else ""
    own, *_, other = releases.hashes(name)
    there, back = releases.converter(name, own, other, part), releases.converter(name, other, own, part)
    assert there is not None
    assert back is not None
    schema = here.sub(f"{name}_{part}") if part else here
    copy = make_vm(compile_check(schema)).convert
    cdr = MessageWriter(schema).message({"goal_id": {"uuid": list(range(16))}, **values})
    newer = there(cdr)
    if back(newer) != cdr or copy(cdr) != cdr:
        msg = f"{case}: the message changed"
        raise SystemExit(msg)
    label = f"{releases.release(name, own)} and {releases.release(name, other)}"
    pairs = {"there": lambda: there(cdr), "back": lambda: back(newer)}
    return [
        Row(f"{case}, {label}, {way}", *compare(call, lambda: copy(cdr), rounds), "us") for way, call in pairs.items()
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15, help="rounds of each comparison (default 15)")
    add_json_option(parser)
    options = parser.parse_args(arguments)
    keep_memory()  # as in the workers; otherwise both cause page faults in turn
    rows = [row for case, (name, values) in CASES.items() for row in measure_case(case, name, values, options.rounds)]
    for case, (name, values) in RELEASES.items():
        rows += measure_release(case, name, values, options.rounds)
    report(rows, options.json)


if __name__ == "__main__":
    main()
