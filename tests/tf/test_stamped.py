"""TFMessages in CDR have the same bytes as those of the general writer."""

from __future__ import annotations

import random

import pytest

from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from bridge.tf.stamped import TF_TYPE, Stamped, read, write


def test_the_bytes_equal_those_of_the_general_writer() -> None:
    registry, chance = Registry(), random.Random(6)
    schema = registry.schema(TF_TYPE)
    check = registry.hub_check(TF_TYPE, registry.ros2(TF_TYPE).type_id)
    for _ in range(100):
        given = [some(chance) for _ in range(chance.randrange(5))]
        whole = MessageWriter(schema).message({"transforms": [value(transform) for transform in given]})
        assert write(given) == whole
        assert read(check(whole)) == given


def test_a_stamp_beyond_32_bits_of_seconds_is_an_error() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        write([Stamped("a", "b", 1 << 62, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))])


def some(chance: random.Random) -> Stamped:
    x, y, z, qx, qy, qz, qw = (chance.uniform(-9, 9) for _ in range(7))
    names = "p" * chance.randrange(9), "ä" * chance.randrange(9)
    return Stamped(*names, chance.randrange(1 << 60), (x, y, z), (qx, qy, qz, qw))


def value(transform: Stamped) -> dict:
    seconds, nanoseconds = divmod(transform.stamp, 1_000_000_000)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": transform.frame_id},
        "child_frame_id": transform.child_frame_id,
        "transform": {
            "translation": dict(zip("xyz", transform.translation, strict=True)),
            "rotation": dict(zip("xyzw", transform.rotation, strict=True)),
        },
    }
