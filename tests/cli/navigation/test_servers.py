"""``midspan waypoints``: the places that Nav2 has missed."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.cli.navigation.servers import missed_places
from bridge.messages.json import CallCodec
from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter

RESULT = "nav2_msgs/action/FollowWaypoints_GetResult"


@pytest.mark.parametrize(("release", "field"), [(0, "index"), (1, "waypoint_index")], ids=["jazzy", "kilted"])
def test_missed_places_are_named_for_each_release_of_nav2(release: int, field: str) -> None:
    registry = Registry()
    type_hash = list(registry.releases.hashes(RESULT))[release]
    _, response = registry.service_schemas(RESULT, type_hash)
    reply: dict[str, Any] = {"status": 4, "result": {"missed_waypoints": [{field: 2}, {field: 0}]}}
    result = CallCodec(registry, RESULT, type_hash).response_value(MessageWriter(response).message(reply))["result"]
    assert missed_places(result, ["hall", "office", "kitchen"]) == "kitchen, hall"
