"""Five types of messages, including a latched map, cross between all dialects and the hub in each direction."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from tests.adapters.zenoh.conftest import Place, until_linked
from tests.support.wait import until

MESSAGES: dict[str, tuple[str, dict[str, Any]]] = {
    "text": ("std_msgs/String", {"data": "ünïcode"}),
    "speed": (
        "geometry_msgs/Twist",
        {"linear": {"x": 1.0, "y": 2.0, "z": 3.0}, "angular": {"x": 4.0, "y": 5.0, "z": 6.0}},
    ),
    "scan": (
        "sensor_msgs/LaserScan",
        {
            "header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "laser"},
            "angle_min": -1.5,
            "range_max": 30.0,
            "ranges": [0.5 * n for n in range(720)],
            "intensities": [],
        },
    ),
    "transforms": (
        "tf2_msgs/TFMessage",
        {
            "transforms": [
                {
                    "header": {"stamp": {"sec": n, "nanosec": 0}, "frame_id": "odom"},
                    "child_frame_id": f"frame{n}",
                    "transform": {"translation": {"x": float(n)}, "rotation": {"w": 1.0}},
                }
                for n in range(20)
            ]
        },
    ),
    "map": (
        "nav_msgs/OccupancyGrid",
        {
            "header": {"frame_id": "map"},
            "info": {"resolution": 0.05, "width": 100, "height": 100, "origin": {"orientation": {"w": 1.0}}},
            "data": [(n % 102) - 1 for n in range(10_000)],
        },
    ),
}
ENDS = ("hub", "ros2dds", "ros1", "json")


def topic(from_: str, to: str, name: str) -> str:
    return f"/{from_}_{to}_{name}"


def name_at(end: str, name: str) -> str:
    """Return a topic's name at one end. JSON has separate keys, because a key cannot carry both JSON and CDR."""
    return f"/json{name}" if end == "json" else name


@pytest.fixture
def ends(place: Place) -> dict[str, Any]:
    """All dialects on one network, and one program on each."""
    pairs = list(itertools.permutations(ENDS, 2))
    keys = [
        {
            "key": name_at("json", topic(*pair, name))[1:],
            "topic": topic(*pair, name),
            "type": type_.replace("/", "/msg/"),
        }
        | ({"direction": "in", "latched": name == "map"} if pair[0] == "json" else {"direction": "out"})
        for pair in pairs
        if "json" in pair
        for name, (type_, _) in MESSAGES.items()
    ]
    place.bridge({"dialect": "ros2dds"}, {"dialect": "ros1", "latched": ["/*_map"]}, {"dialect": "json", "keys": keys})
    programs = {"ros2dds": place.ros2dds(), "ros1": place.ros1(), "json": place.json()}
    for program in programs.values():
        until_linked(program, 5)  # the three dialects and the two other programs
    return {"hub": place.far, **programs}


def test_messages_cross_between_every_pair(ends: dict[str, Any]) -> None:
    pairs = list(itertools.permutations(ENDS, 2))
    out, subscription = {}, {}
    for from_, to in pairs:
        for name, (type_, _) in MESSAGES.items():
            place = from_, to, name
            out[place] = ends[from_].advertise(name_at(from_, topic(*place)), type_, latched=name == "map", depth=1)
            subscription[place] = ends[to].subscribe(name_at(to, topic(*place)), type_, latched=name == "map", depth=10)
    waiting = set(out)

    def all_heard() -> bool:
        for place in sorted(waiting):
            from_, to, name = place
            got = ends[to].wait(subscription[place], 1, 0)
            if got:
                assert holds(got[0], MESSAGES[name][1]), (place, got[0])
                waiting.discard(place)
            else:
                ends[from_].publish(out[place], MESSAGES[name][1])
        return not waiting

    until(all_heard, "every message crosses in every direction", 60, every=0.3)


@pytest.mark.parametrize("from_", ENDS)
def test_a_map_that_was_published_once_reaches_late_joiners(ends: dict[str, Any], place: Place, from_: str) -> None:
    type_, message = MESSAGES["map"]
    for to in (end for end in ENDS if end != from_):
        name = topic(from_, to, "map")
        out = ends[from_].advertise(name_at(from_, name), type_, latched=True, depth=1)
        side = f"zenoh_{to}" if to != "hub" else f"zenoh_{from_}"
        direction = "out" if to != "hub" else "in"
        if from_ in ("ros1", "json"):  # these dialects have no cache, so messages are received only live
            ends[from_].until_subscribed(out)
        ends[from_].publish(out, message)
        until(
            lambda s=side, n=name, d=direction: (place.route(s, n, d) or {}).get("messages"), f"{name}", 20, every=0.1
        )
        if to == "json":
            program, key = ends[to], name_at(to, name)[1:]
            replies = until(lambda p=program, k=key: p.get(k), "the map is cached")
            assert holds(replies[0][0], message)
        else:
            late = ends[to].subscribe(name, type_, latched=True, depth=1)
            assert holds(ends[to].wait(late, 1, 60)[0], message)


def holds(got: Any, given: Any) -> bool:
    """Return whether a message has the given fields. ROS 1's header has a number, and octets may be base64."""
    if isinstance(given, dict):
        return all(name in got and holds(got[name], value) for name, value in given.items())
    if isinstance(given, list):
        return len(got) == len(given) and all(holds(g, v) for g, v in zip(got, given, strict=True))
    return bool(got == (pytest.approx(given, rel=1e-6) if isinstance(given, float) else given))
