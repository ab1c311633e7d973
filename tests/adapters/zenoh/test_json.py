"""JSON on plain keys, for programs without ROS."""

from __future__ import annotations

import base64
import json
import threading
from typing import Any

import pytest
import zenoh

from bridge.adapters.zenoh import json_keys
from bridge.adapters.zenoh.json_keys import LatchedKeySubscription, cdr_to_text, text_to_cdr
from bridge.adapters.zenoh.topics import KeySubscription
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from tests.adapters.zenoh.conftest import Place, cross, until_linked
from tests.support.wait import until

STRING = "std_msgs/String"
SIDE = "zenoh_json"
REGISTRY = Registry()


def keys(*entries: dict[str, Any]) -> dict[str, Any]:
    return {"dialect": "json", "keys": [{"type": "std_msgs/msg/String", **entry} for entry in entries]}


def test_values_that_json_cannot_represent_become_texts_and_return() -> None:
    scan, image = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/CompressedImage"
    text = b'{"header": {"stamp": {"sec": 7, "nanosec": 8}}, "ranges": [1.5, "NaN", "Infinity", "-Infinity"]}'
    back = json.loads(cdr_to_text(REGISTRY, scan)(text_to_cdr(REGISTRY, scan)(text)))
    assert back["ranges"] == [1.5, "NaN", "Infinity", "-Infinity"]
    assert back["header"] == {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": ""}
    octets = base64.b64encode(b"\x00\xff").decode()
    for given in (f'"{octets}"', "[0, 255]"):
        cdr = text_to_cdr(REGISTRY, image)(f'{{"data": {given}}}'.encode())
        assert json.loads(cdr_to_text(REGISTRY, image)(cdr))["data"] == octets


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (b'{"data": "hi"', "invalid JSON"),
        (b"\xff\xfe\x00", "invalid JSON"),
        (b"[" * 100_000, "invalid JSON"),
        (b"[1]", "has to be a JSON object"),
        (b"null", "has to be a JSON object"),
        (b'{"dat": "hi"}', "did you mean 'data'"),
        (b'{"data": 3}', "data must be text"),
        (b'{"data": "\\ud800"}', "cannot be encoded"),
    ],
)
def test_invalid_json_is_refused_with_the_reason(text: bytes, reason: str) -> None:
    with pytest.raises(ConversionError, match=reason):
        text_to_cdr(REGISTRY, "std_msgs/msg/String")(text)


def test_json_keys_are_bridged_in_their_configured_directions_only(place: Place) -> None:
    program = place.json()
    place.bridge(
        keys(
            {"key": "robot/speech", "direction": "in"},
            {"key": "robot/orders", "direction": "out", "topic": "/to_robot"},
            {"key": "talk", "direction": "both"},
        )
    )
    text, talked = (place.far.subscribe(t, STRING) for t in ("/robot/speech", "/talk"))
    assert cross(program, program.advertise("robot/speech"), place.far, text, {"data": "in"}) == {"data": "in"}
    orders, talks = program.subscribe("robot/orders"), program.subscribe("talk")
    reported, talk = (place.far.advertise(t, STRING) for t in ("/to_robot", "/talk"))
    assert cross(place.far, reported, program, orders, {"data": "out"}) == {"data": "out"}
    assert cross(place.far, talk, program, talks, {"data": "there"}) == {"data": "there"}
    assert cross(program, program.advertise("talk"), place.far, talked, {"data": "back"}) == {"data": "back"}
    # no message has returned to the side from which it came
    assert {m["data"] for m in place.far.wait(talked, 10_000, 0.5)} == {"back"}
    wrong = place.far.advertise("/robot/speech", STRING)
    place.far.publish(wrong, {"data": "not published on this key"})

    def decided() -> list[str]:
        return [line["decision"] for line in place.explain(SIDE, "/robot/speech") if line["direction"] == "out"]

    assert until(decided, "explain has a decision", every=0.1) == ["own"]
    assert place.answer(SIDE)["refused"] == []


def test_a_late_reader_gets_the_newest_message(place: Place) -> None:
    place.bridge(keys({"key": "mode", "direction": "out"}))
    program = place.json()
    samples: list[zenoh.Sample] = []
    program.session.declare_subscriber("mode", zenoh.handlers.Callback(samples.append, indirect=False))
    out = place.far.advertise("/mode", STRING, latched=True, depth=1)

    def published() -> list[zenoh.Sample]:
        place.far.publish(out, {"data": "first"})
        return samples

    until(published, "the sample arrives", every=0.1)
    assert samples[0].payload.to_bytes() == b'{"data":"first"}'
    assert (str(samples[0].encoding), samples[0].attachment) == ("application/json", None)
    until(lambda: program.get("mode") == [({"data": "first"}, "application/json")], "the message is cached")
    place.far.publish(out, {"data": "second"})
    until(lambda: program.get("mode") == [({"data": "second"}, "application/json")], "the newest message is cached")
    place.far.drop(out)
    until(lambda: program.get("mode") == [], "messages of a publisher that left are no longer cached")


def test_a_latched_key_is_queried_for_earlier_values(place: Place) -> None:
    """A program or zenoh storage that has a key's value replies to a get, for late joiners on the hub."""
    program = place.json()
    kept = program.session.declare_queryable("mode", lambda query: query.reply("mode", b'{"data": "kept"}'))
    place.bridge(keys({"key": "mode", "direction": "in", "latched": True}))
    subscription = place.far.subscribe("/mode", STRING, latched=True)
    assert place.far.wait(subscription, 1, 60)[:1] == [{"data": "kept"}]
    kept.undeclare()


def test_a_latched_key_is_queried_when_a_program_with_its_value_appears(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program may start later, or its router may be linked later, or again after a link was lost."""
    changes, on_match_changed = list[bool](), LatchedKeySubscription._on_match_changed

    def record(subscription: LatchedKeySubscription, status: zenoh.MatchingStatus) -> None:
        on_match_changed(subscription, status)
        changes.append(status.matching)

    monkeypatch.setattr(LatchedKeySubscription, "_on_match_changed", record)
    place.bridge(keys({"key": "mode", "direction": "in", "latched": True}))
    subscription = place.far.subscribe("/mode", STRING, latched=True)
    place.until_route(SIDE, "/mode", "in")
    program = place.json()
    for value in ("first", "missed"):
        text = json.dumps({"data": value}).encode()
        kept = program.session.declare_queryable("mode", lambda query, text=text: query.reply("mode", text))
        until(lambda value=value: ended(place.far.wait(subscription, 1, 0.1), value), "the value arrives")
        kept.undeclare()
        program.session.put("mode", json.dumps({"data": f"{value} is over"}).encode())
        until(
            lambda value=value: ended(place.far.wait(subscription, 1, 0.1), f"{value} is over"), "the next one arrives"
        )
        until(lambda: changes[-1:] == [False], "the bridge has noticed that the value is no longer stored")


def test_a_latched_key_is_queried_again_after_a_lost_reply(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    # many times: zenoh may still be linking the sessions, and lose further replies
    monkeypatch.setattr(json_keys, "AGAIN_SECONDS", 100 * (0.05,))
    program, queries = place.json(), list[str]()

    def answer(query: zenoh.Query) -> None:
        queries.append(str(query.key_expr))
        if len(queries) > 2:
            query.reply("mode", b'{"data": "kept"}')

    kept = program.session.declare_queryable("mode", zenoh.handlers.Callback(answer, indirect=True))
    place.bridge(keys({"key": "mode", "direction": "in", "latched": True}))
    subscription = place.far.subscribe("/mode", STRING, latched=True)
    assert place.far.wait(subscription, 1, 60)[:1] == [{"data": "kept"}]
    kept.undeclare()


def test_a_stored_value_never_follows_a_newer_one(place: Place) -> None:
    """A program may publish a newer value before the stored one arrives."""
    program = place.json()

    def answer(query: zenoh.Query) -> None:
        program.session.put("mode", b'{"data": "new"}')
        query.reply("mode", b'{"data": "old"}')

    handler = zenoh.handlers.Callback(answer, indirect=True)
    subscription = place.far.subscribe("/mode", STRING, latched=True)
    place.bridge(keys({"key": "mode", "direction": "in", "latched": True}))
    until_linked(program)
    kept = program.session.declare_queryable("mode", handler)
    assert place.far.wait(subscription, 1, 60)[:1] == [{"data": "new"}]
    program.session.put("mode", b'{"data": "newest"}')  # another query may follow, to which the program replies again
    until(lambda: {"data": "newest"} in place.far.wait(subscription, 1, 0.1), "the last value arrives")
    assert {"data": "old"} not in place.far.wait(subscription, 0)
    kept.undeclare()


def ended(received: list[Any], last: str) -> list[Any]:
    return received if received[-1:] == [{"data": last}] else []


Stored = tuple[str, bool, int]
"""A value, whether it is stored, and its time stamp in seconds, 0 for none."""


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([("a", True, 2), ("b", True, 1)], ["a"]),
        ([("a", True, 1), ("b", True, 2)], ["a", "b"]),
        ([("a", True, 1), ("b", True, 0)], ["a", "b"]),
        ([("a", False, 2), ("b", True, 1)], ["a"]),
        ([("a", False, 2), ("b", True, 2)], ["a"]),
        ([("a", False, 1), ("b", True, 2)], ["a", "b"]),
        ([("a", False, 0), ("b", True, 2)], ["a"]),
        ([("a", True, 2), ("b", False, 1)], ["a", "b"]),
    ],
)
def test_time_stamps_order_stored_values(
    values: list[Stored], expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    part, received = LatchedKeySubscription.__new__(LatchedKeySubscription), list[str]()
    part._order, part._published, part._newest = threading.Lock(), False, 0
    monkeypatch.setattr(KeySubscription, "native", lambda _self, _sample: "source")
    monkeypatch.setattr(KeySubscription, "accept", lambda _self, sample, _source: received.append(sample[0]))
    monkeypatch.setattr(json_keys, "ticks", lambda sample: sample[2])
    for value in values:
        if value[1]:
            part.on_stored(value)  # type: ignore[arg-type]
        else:
            part.accept(value, "source")  # type: ignore[arg-type]
    assert received == expected


def test_invalid_json_is_counted_and_does_not_stop_the_key(place: Place) -> None:
    program = place.json()
    place.bridge(keys({"key": "talk", "direction": "in"}))
    until_linked(program)
    subscription = place.far.subscribe("/talk", STRING)
    out = program.advertise("talk")
    cross(program, out, place.far, subscription, {"data": "probe"})
    for bad in (b"", b"{", b'{"datum": 1}', b"\x00\x01\x00\x00"):
        program.session.put("talk", bad)
    until(lambda: place.route(SIDE, "/talk", "in")["drops"]["bad"] == 4, "four are counted", every=0.1)
    assert place.route(SIDE, "/talk", "in")["error"]
    program.publish(out, {"data": "good"})
    until(lambda: {"data": "good"} in place.far.wait(subscription, 1, 0.1), "the valid message arrives")


def test_a_velocity_command_is_never_cached(place: Place) -> None:
    """A command is cached neither for a get nor for late joiners, in any configuration."""
    program = place.json()
    twist = "geometry_msgs/msg/Twist"
    place.bridge(keys({"key": "cmd_vel", "type": twist, "latched": True}))
    subscription = place.far.subscribe("/cmd_vel", "geometry_msgs/Twist")
    cross(program, program.advertise("cmd_vel"), place.far, subscription, {"linear": {"x": 0.5}})
    assert not any(p.qos.latched for p in place.far.publishers("/cmd_vel"))
    out = place.far.advertise("/cmd_vel", "geometry_msgs/Twist", latched=True, depth=1)
    back = program.subscribe("cmd_vel")
    assert cross(place.far, out, program, back, {"linear": {"x": 0.25}})["linear"]["x"] == 0.25
    assert program.get("cmd_vel") == []


def test_a_key_cannot_carry_cdr_and_json(place: Place) -> None:
    """The ros2dds dialect on the same network ignores a JSON key in both directions, and reports that."""
    bridge, program = place.ros2dds(), place.json()
    place.bridge({"dialect": "ros2dds"}, keys({"key": "talk"}))
    subscription = program.subscribe("talk")
    out = place.far.advertise("/talk", STRING)
    assert cross(place.far, out, program, subscription, {"data": "json"}) == {"data": "json"}
    assert bridge.tokens("/talk") == []

    def why() -> list[str]:
        return [x["why"] for x in place.explain("zenoh_ros2dds", "/talk") if x["direction"] == "out"]

    assert "JSON" in until(why, "explain has a decision", every=0.1)[0]
    bridge.advertise("/talk", STRING)
    until(lambda: [w for w in place.answer("zenoh_ros2dds")["warnings"] if "JSON" in w], "it is reported", every=0.1)


def test_services_are_called_by_a_get(place: Place) -> None:
    """Programs offer services, and call services, with a get."""
    program, set_bool, trigger = place.json(), "std_srvs/srv/SetBool", "std_srvs/srv/Trigger"
    place.bridge(
        {
            "dialect": "json",
            "keys": [
                {"key": "robot/light", "type": set_bool, "direction": "in"},
                {"key": "robot/beep", "topic": "/beep", "type": trigger, "direction": "out"},
                {"key": "robot/arm", "topic": "/arm", "type": set_bool, "direction": "out"},
            ],
        }
    )
    missing = place.far.call("/robot/light", "std_srvs/SetBool", data=True).result()
    assert "no server of /robot/light is on this zenoh network" in missing["error"]
    requests: list[Any] = []

    def light(query: zenoh.Query) -> None:
        requests.append(json.loads(query.payload.to_bytes()))
        with query:
            query.reply("robot/light", b'{"success": true, "message": "on"}')

    queryable = program.session.declare_queryable("robot/light", zenoh.handlers.Callback(light, indirect=False))
    on = {"success": True, "message": "on"}
    until(
        lambda: place.far.call("/robot/light", "std_srvs/SetBool", data=True).result()["reply"] == on,
        "the program replies",
    )
    assert requests[-1] == {"data": True}
    queryable.undeclare()
    place.far.serve("/beep", "std_srvs/Trigger", reply=on)
    arm = place.far.serve("/arm", "std_srvs/SetBool", error="the arm is stuck")
    replies = until(lambda: program.get("robot/beep"), "the service replies", every=0.1)
    assert replies == [(on, "application/json")]
    place.until_route(SIDE, "/arm", "out")

    def errors(payload: bytes | None) -> str:
        return "".join(r.err.payload.to_bytes().decode() for r in program.session.get("robot/arm", payload=payload))

    assert until(lambda: errors(b'{"data": true}'), "an error") == "the arm is stuck"
    assert "did you mean 'data'" in errors(b'{"dat": true}')
    assert "has no payload" in errors(None)
    assert arm.requests() == [{"data": True}]
    # a query for all keys is not a call
    served = place.route(SIDE, "/beep", "out")["calls"]
    assert list(program.session.get("robot/**", timeout=2.0)) == []
    assert place.route(SIDE, "/beep", "out")["calls"] == served
