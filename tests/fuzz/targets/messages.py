"""Message bytes: the converters, the checks, and conversion to and from JSON."""

from __future__ import annotations

import json
from collections.abc import Callable

from bridge.messages.errors import ConversionError
from tests.fuzz.target import Subject, Target

_TYPES = (
    "std_msgs/msg/String",
    "std_msgs/msg/Empty",
    "std_msgs/msg/Bool",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "nav_msgs/msg/OccupancyGrid",
    "diagnostic_msgs/msg/DiagnosticArray",
    "visualization_msgs/msg/MarkerArray",
    "std_msgs/msg/Float64MultiArray",
    "rcl_interfaces/msg/ParameterEvent",
    "rcl_interfaces/msg/Log",
)


def _machine() -> Subject:
    """The conversion machine; an input's first byte selects the program."""
    from bridge.messages.registry import Registry
    from bridge.messages.transcode.conversion import make_vm
    from tests.fuzz.machines import guard
    from tests.messages.transcode.programs import TYPES, programs

    registry = Registry()
    machines = [(make_vm(program), good) for name in TYPES for program, good in programs(registry, name)]

    def parse(data: bytes) -> None:
        machine, _ = machines[data[0] % len(machines)] if data else machines[0]
        message = data[1:]
        guard(message)
        machine.convert(message)

    return Subject(parse, [bytes([number]) + good for number, (_, good) in enumerate(machines)], (ConversionError,))


def _convert() -> Subject:
    """The bridge's conversions; their output is valid input for the other direction, in normal form."""
    from bridge.messages.json import from_json
    from bridge.messages.registry import Registry
    from tests.messages.samples import sample

    registry = Registry()
    conversions: list[tuple[Callable[[bytes], bytes], Callable[[bytes], bytes]]] = []
    seeds: list[bytes] = []
    for name in _TYPES:
        check, back = registry.hub_check(name), registry.hub_to_ros1(name)
        onward_conversion = registry.ros1_to_hub(back.target.name, back.target.type_id)
        assert back.convert is not None
        assert onward_conversion.convert is not None
        for length in (0, 1, 3):
            cdr = from_json(registry, name, sample(registry.schema(name), length))
            goods = (cdr, back.convert(cdr), cdr)
            seeds += [bytes([len(conversions) + number]) + good for number, good in enumerate(goods)]
        conversions += [(back.convert, onward_conversion.convert), (onward_conversion.convert, check), (check, check)]

    def parse(data: bytes) -> None:
        convert, onward = conversions[data[0] % len(conversions)] if data else conversions[0]
        out = convert(data[1:])
        try:
            again = onward(out)
        except ConversionError as err:
            raise AssertionError(f"the output is rejected: {err}") from err
        assert onward is not convert or again is out, "the check's result is not in its normal form"

    return Subject(parse, seeds, (ConversionError,))


def _rosbags() -> Subject:
    """Accepted messages are converted to the same bytes as by rosbags."""
    from rosbags.typesys import Stores, get_typestore

    from bridge.messages.json import from_json
    from bridge.messages.registry import Registry
    from tests.messages.samples import sample

    registry, store = Registry(), get_typestore(Stores.ROS2_JAZZY)
    same = [name for name in _TYPES if not name.startswith(("rcl_interfaces", "visualization_msgs"))]
    seeds: list[bytes] = []
    conversions = []
    for name in same:
        check, back = registry.hub_check(name), registry.hub_to_ros1(name)
        from_ros1 = registry.ros1_to_hub(back.target.name, back.target.type_id).convert
        assert back.convert is not None
        assert from_ros1 is not None
        cdr = from_json(registry, name, sample(registry.schema(name)))
        seeds += [bytes([2 * len(conversions)]) + cdr, bytes([2 * len(conversions) + 1]) + back.convert(cdr)]
        conversions.append((name, check, back.convert, from_ros1))

    def parse(data: bytes) -> None:
        number = data[0] % (2 * len(conversions)) if data else 0
        name, check, to_ros1, to_hub = conversions[number // 2]
        message = data[1:]
        if number % 2:
            ours = to_hub(message)
            normal = to_ros1(ours)  # bools other than 0 and 1 become 1, but rosbags keeps them
            theirs = bytes(store.ros1_to_cdr(normal, name))
        else:
            ours = to_ros1(message)
            theirs = bytes(store.cdr_to_ros1(check(message), name))
        assert ours == theirs, f"{name}: {ours.hex()} and rosbags {theirs.hex()}"

    return Subject(parse, seeds, (ConversionError,), largest=2048)


def _to_json() -> Subject:
    """Messages converted to JSON, as for ``topic echo``."""
    from bridge.messages.json import from_json, to_json
    from bridge.messages.registry import Registry
    from tests.messages.samples import sample

    registry = Registry()
    seeds = [
        bytes([number]) + from_json(registry, name, sample(registry.schema(name))) for number, name in enumerate(_TYPES)
    ]

    def parse(data: bytes) -> None:
        name = _TYPES[data[0] % len(_TYPES)] if data else _TYPES[0]
        json.dumps(to_json(registry, name, data[1:]))

    return Subject(parse, seeds, (ConversionError,), largest=2048)


def _from_json() -> Subject:
    """Messages from JSON, as for ``topic pub`` and on plain zenoh keys."""
    from bridge.messages.json import from_json
    from bridge.messages.registry import Registry
    from tests.messages.samples import sample

    registry = Registry()
    seeds = [bytes([number]) + json.dumps(sample(registry.schema(name))).encode() for number, name in enumerate(_TYPES)]

    def parse(data: bytes) -> None:
        name = _TYPES[data[0] % len(_TYPES)] if data else _TYPES[0]
        try:
            value = json.loads(data[1:])
        except (ValueError, RecursionError):
            return
        from_json(registry, name, value)

    tokens = [
        b"null",
        b"true",
        b"1e400",
        b"NaN",
        b"-Infinity",
        b'"\\ud800"',
        b'"data":',
        b"{}",
        b"[]",
        b'"header":',
        b"1.0",
    ]
    return Subject(parse, seeds, (ConversionError,), tokens, largest=4096)


def _static_tf() -> Subject:
    """Merging of static transforms."""
    from bridge.messages.json import from_json
    from bridge.messages.registry import Registry
    from bridge.routing.rewrites import TF_TYPE, StaticTransforms
    from tests.messages.samples import sample

    registry = Registry()
    check = registry.hub_check(TF_TYPE)
    kept = [StaticTransforms()]

    def parse(data: bytes) -> None:
        merged = kept[0].merge(data)
        assert check(merged) == merged
        if len(kept[0]) > 40:
            kept[0] = StaticTransforms()

    seeds = [from_json(registry, TF_TYPE, sample(registry.schema(TF_TYPE), length)) for length in (0, 1, 3)]
    return Subject(parse, seeds, (ValueError,), largest=1024)


TARGETS = (
    Target("machine", 400_000, _machine),
    Target("convert", 150_000, _convert),
    Target("rosbags", 20_000, _rosbags),
    Target("to_json", 10_000, _to_json),
    Target("from_json", 6_000, _from_json),
    Target("static_tf", 3_000, _static_tf),
)
