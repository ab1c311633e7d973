"""Every type that Noetic and Jazzy share survives the round trip, and converts exactly as rosbags does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from bridge.messages.definitions.hashes import EMPTY_MEMBER
from bridge.messages.definitions.schema import World
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from tests.messages.samples import sample, standard_pairs

JAZZY = get_typestore(Stores.ROS2_JAZZY)
NOETIC = get_typestore(Stores.ROS1_NOETIC)
LAYOUT_DIFFERS = {
    "sensor_msgs/msg/Range",
    "shape_msgs/msg/SolidPrimitive",
    "visualization_msgs/msg/Marker",
    "visualization_msgs/msg/MarkerArray",
    "visualization_msgs/msg/InteractiveMarker",
    "visualization_msgs/msg/InteractiveMarkerControl",
    "visualization_msgs/msg/InteractiveMarkerInit",
    "visualization_msgs/msg/InteractiveMarkerUpdate",
}
TYPES = [name for name in standard_pairs() if not name.startswith("builtin_interfaces/")]


def plain(value: Any, store: Typestore = JAZZY) -> Any:
    """Convert a rosbags message to plain values."""
    if hasattr(value, "__msgtype__"):
        names = [name for name, _ in store.fielddefs[value.__msgtype__][1] if name != EMPTY_MEMBER]
        return {name: plain(getattr(value, name), store) for name in names}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [plain(item, store) for item in value]
    return value


def test_list_of_types_is_complete():
    assert len(TYPES) > 110
    assert set(TYPES) >= LAYOUT_DIFFERS


@pytest.mark.parametrize("name", TYPES)
def test_encoded_messages_are_read_by_rosbags(name: str, registry: Registry):
    schema = registry.schema(name)
    values = sample(schema)
    assert plain(JAZZY.deserialize_cdr(from_json(registry, name, values), name)) == values


@pytest.mark.parametrize("length", [0, 1, 3])
@pytest.mark.parametrize("name", sorted(set(TYPES) - LAYOUT_DIFFERS))
def test_same_layouts_convert_as_rosbags_does(name: str, length: int, registry: Registry):
    cdr = from_json(registry, name, sample(registry.schema(name), length))
    to_ros1, to_hub = conversions(name, registry)
    ros1 = to_ros1(cdr)
    assert ros1 == bytes(JAZZY.cdr_to_ros1(cdr, name))
    assert to_hub(ros1) == cdr == bytes(JAZZY.ros1_to_cdr(ros1, name))


@pytest.mark.parametrize("length", [0, 1, 3])
@pytest.mark.parametrize("name", sorted(LAYOUT_DIFFERS))
def test_different_layouts_keep_common_fields(name: str, length: int, registry: Registry):
    values = sample(registry.schema(name), length)
    to_ros1, to_hub = conversions(name, registry)
    ros1 = to_ros1(from_json(registry, name, values))
    in_ros1 = plain(NOETIC.deserialize_ros1(ros1, name), NOETIC)
    back = plain(JAZZY.deserialize_cdr(to_hub(ros1), name))
    assert common(values, in_ros1) == common(in_ros1, values)
    assert common(values, back, in_ros1) == common(back, values, in_ros1)
    assert to_ros1(to_hub(ros1)) == ros1
    # After the round trip, fields that ROS 1 lacks have their defaults.
    empty = from_json(registry, name, {})
    assert to_hub(to_ros1(empty)) == empty


def test_ros2_only_fields_get_their_defaults(registry: Registry):
    _, to_hub = conversions("visualization_msgs/msg/Marker", registry)
    schema = registry.schema("visualization_msgs/msg/Marker")
    to_ros1, _ = conversions("visualization_msgs/msg/Marker", registry)
    back = plain(
        JAZZY.deserialize_cdr(
            to_hub(to_ros1(from_json(registry, schema.name, sample(schema)))), "visualization_msgs/msg/Marker"
        )
    )
    assert back["uv_coordinates"] == []
    assert back["texture_resource"] == ""
    assert back["texture"]["header"]["frame_id"] == ""
    assert back["mesh_file"] == {"filename": "", "data": []}


def conversions(name: str, registry: Registry) -> tuple[Any, Any]:
    to_ros1 = registry.hub_to_ros1(name)
    to_hub = registry.ros1_to_hub(to_ros1.target.name, to_ros1.target.type_id)
    assert to_hub.target.name == name
    assert to_hub.target.type_id == registry.ros2(name).type_id
    assert registry.schema(name).world is World.ROS2
    return to_ros1.convert, to_hub.convert


def common(value: Any, *others: Any) -> Any:
    """Return the value without ``Header.seq`` and without fields that any of the other values lacks."""
    if isinstance(value, dict):
        keys = [key for key in value if key != "seq" and all(key in other for other in others)]
        return {key: common(value[key], *(other[key] for other in others)) for key in keys}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [common(item, *(other[k] for other in others)) for k, item in enumerate(value)]
    return value
