"""Rules about the versions of a package: renamed and retyped fields, lost values, and rules that cannot apply."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bridge.config.document import ConfigError
from bridge.config.load import load
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.unchanged import same
from bridge.messages.values import MessageReader, MessageWriter
from tests.messages.fleet import CALIBRATE, RULES, TURN, WHEEL, write_package, write_versions

Configured = Callable[[list[dict[str, Any]]], Path]


@pytest.fixture
def configured(tmp_path: Path) -> Configured:
    """Return a function that writes a configuration with both package versions and given rules; it returns the path."""
    write_versions(tmp_path)

    def write(rules: list[dict[str, Any]]) -> Path:
        (tmp_path / "rules.yaml").write_text(json.dumps(rules))
        file = tmp_path / "midspan.yaml"
        file.write_text("types: {folders: [new, old], mapping_rules: [rules.yaml]}\n")
        return file

    return write


@pytest.fixture
def registry(configured: Configured) -> Registry:
    return Registry.of(load(configured(RULES)).types)


def ends(registry: Registry, name: str, *, older: bool) -> tuple[str, str]:
    """Return the hashes of source and target; with ``older``, the conversion is from the newer to the older version."""
    new, old = registry.releases.hashes(name)
    return (new, old) if older else (old, new)


def convert(registry: Registry, name: str, value: dict[str, Any], *, older: bool, part: str = "") -> dict[str, Any]:
    source, target = ends(registry, name, older=older)
    converter = registry.releases.converter(name, source, target, part)
    assert converter is not None
    schemas = [registry.schema(name, version) for version in (source, target)]
    one, two = (schema.sub(f"{name}_{part}") if part else schema for schema in schemas)
    return MessageReader(two, converter(MessageWriter(one).message(value))).message()


def test_renamed_and_retyped_fields_keep_their_values(registry: Registry) -> None:
    slip = {"at": 1 << 40, "bad": True}
    old = {"name": "left", "rpm": 0.1, "load": -7, "past": [0.5, math.inf], "code": "12", "slips": [slip]}
    new = convert(registry, WHEEL, old, older=False)
    assert new["name"] == "left"
    assert new["speed"] == pytest.approx(0.1, rel=1e-7)
    assert (new["load"], new["past"].tolist(), new["code"], new["kind"]) == (-7, [0.5, math.inf], 12, 7)
    assert new["slips"] == [{"bad": 1, "at": float(1 << 40)}]
    back = convert(registry, WHEEL, {**new, "speed": 2.5}, older=True)
    assert back["past"].tolist() == [0.5, math.inf]
    assert back["past"].dtype == "float32"
    assert {**back, "past": old["past"]} == {**old, "rpm": 2.5}


def test_services_and_actions_are_converted_between_versions(registry: Registry) -> None:
    for older, names in ((False, ("target", "goal")), (True, ("goal", "target"))):
        sent, received = names
        assert convert(registry, CALIBRATE, {sent: 1.5}, older=older, part="Request") == {received: 1.5}
        assert convert(registry, CALIBRATE, {"offset": 0.5}, older=older, part="Response") == {"offset": 0.5}
        one, two = ("radians", "angle") if older else ("angle", "radians")
        goal = convert(registry, f"{TURN}_SendGoal", {"goal": {one: 1.5}}, older=older, part="Request")
        assert goal["goal"] == {two: 1.5}
        feedback = convert(registry, f"{TURN}_FeedbackMessage", {"feedback": {"at": 0.25}}, older=older)
        assert feedback["feedback"] == {"at": 0.25}


def test_text_that_is_not_utf_8_is_not_changed(registry: Registry) -> None:
    source, target = ends(registry, WHEEL, older=True)
    converter = registry.releases.converter(WHEEL, source, target)
    assert converter is not None
    message = MessageWriter(registry.schema(WHEEL, source)).message({"name": "x"}).replace(b"x\0", b"\xe9\0")
    assert b"\xe9\0" in converter(message)


@pytest.mark.parametrize(
    ("older", "value", "fault"),
    [
        (False, {"code": "twelve"}, r"code must be a text with a number, not 'twelve'"),
        (False, {"code": "1", "load": 40_000}, "load must be int16, not 40000"),
        (True, {"speed": 1e39}, r"rpm must be float32, not 1e\+39"),
        (True, {"past": [1.0, 1e39]}, "past has a value that does not fit float32"),
        (True, {"slips": [{"bad": 2}]}, r"slips\.bad must be bool, not 2"),
        (True, {"slips": [{"at": math.nan}]}, r"slips\.at must be int64, not nan"),
    ],
)
def test_values_that_do_not_fit_are_refused(registry: Registry, older: bool, value: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConversionError, match=fault):
        convert(registry, WHEEL, value, older=older)


def test_fields_that_lose_information_are_named(registry: Registry) -> None:
    new, old = ends(registry, WHEEL, older=True)
    slip = "fleet_msgs/msg/Slip"
    assert registry.releases.losses(WHEEL, new, old) == (
        (f"{WHEEL}.kind",),
        (
            f"{WHEEL}.speed is rounded to float32",
            f"{WHEEL}.past is rounded to float32",
            f"{slip}.bad must be in the range of bool, or its message is refused",
            f"{slip}.at is rounded to int64, and its message is refused beyond the range",
        ),
    )
    _, changed = registry.releases.losses(WHEEL, old, new)
    assert changed == (
        f"{WHEEL}.load must be in the range of int16, or its message is refused",
        f"{WHEEL}.code must be a text with a number, or its message is refused",
        f"{slip}.at is rounded to float32",
    )


def test_versions_that_differ_only_in_a_field_name_need_no_conversion(tmp_path: Path) -> None:
    for number, name in enumerate(("one", "two")):
        write_package(tmp_path / str(number) / "own_msgs", {"msg/Own.msg": f"int32 {name}\nint32 last\n"})
    rules = tmp_path / "rules.yaml"
    rules.write_text("[{message: own_msgs/msg/Own, fields: {one: two}}]")
    registry = Registry([tmp_path / "0", tmp_path / "1"], [rules])
    first, second = registry.releases.hashes("own_msgs/msg/Own")
    assert registry.releases.converter("own_msgs/msg/Own", first, second) is same
    assert registry.releases.losses("own_msgs/msg/Own", first, second) == ((), ())


@pytest.mark.parametrize(
    ("rules", "fault"),
    [
        ([{"message": WHEEL, "field": {}}], "unknown key 'field' in a version rule; the keys are message,"),
        ([{"message": "fleet_msgs/Wheel"}], "message is 'fleet_msgs/Wheel'; write message: package/msg/Name"),
        ([{"message": CALIBRATE}], "write message: package/msg/Name"),
        ([{"message": WHEEL, "messages": [WHEEL, WHEEL]}], "has both message and messages; keep one"),
        ([{"messages": [WHEEL]}], r"messages is \['fleet_msgs/msg/Wheel'\]"),
        ([{"message": WHEEL, "fields": ["rpm"]}], "fields is not a mapping of older field names to newer ones"),
        ([{"message": WHEEL, "defaults": {"kind": {}}}], "defaults is not a mapping of field names to numbers"),
        ([{"message": "other_msgs/msg/Wheel"}],
         "no definition of other_msgs/msg/Wheel is known; add a separate folder"),
        ([{"message": "std_msgs/msg/Header"}],
         "only one version of std_msgs/msg/Header is known; add a separate folder"),
        ([{"message": WHEEL, "fields": {"rmp": "speed"}}], "no known version .* has a field 'rmp'; did you mean 'rpm'"),
        ([{"message": WHEEL, "fields": {"name": "title"}}], "has a field 'title'; its fields: name, rpm, load"),
        ([{"message": WHEEL, "fields": {"rpm": "load"}}, {"message": WHEEL, "fields": {"rpm": "speed"}}],
         "entry 2: maps rpm to speed, which contradicts rpm to load in .*, entry 1; keep one of them"),
        ([{"message": WHEEL, "fields": {"rpm": "speed", "load": "speed"}}], "both rpm and load become speed; keep one"),
        ([{"message": WHEEL, "fields": {"rpm": "past"}}], r"rpm \(float32\) cannot become past \(float64\[\]\): only"),
        ([{"message": WHEEL, "fields": {"slips": "speed"}}], "cannot become speed .* a nested message cannot become"),
        ([{"message": WHEEL, "fields": {"speed": "kind"}}],
         "only one known version of fleet_msgs/msg/Wheel has speed or kind, and it has both; add"),
        ([{"message": WHEEL, "defaults": {"knd": 1}}], "has a field 'knd'; did you mean 'kind'"),
        ([{"message": WHEEL, "defaults": {"kind": 300}}],
         "the default does not fit: kind must be uint8, not 300; write"),
        ([{"message": WHEEL, "defaults": {"kind": 1}}, {"message": WHEEL, "defaults": {"kind": 2}}],
         "entry 2: the default of kind differs from that in .*, entry 1"),
        ([{"ros1_package_name": "old_msgs"}], "needs ros1_package_name and ros2_package_name"),
    ],
)  # fmt: skip
def test_rules_that_cannot_apply_are_problems_of_the_configuration(
    configured: Configured, rules: list[dict[str, Any]], fault: str
) -> None:
    with pytest.raises(ConfigError, match=fault) as caught:
        load(configured(rules))
    (problem,) = caught.value.problems
    assert (problem.key, problem.line) == ("types.mapping_rules[0]", 1)
    assert "rules.yaml, entry " in problem.text
