"""The ``yarp`` section: invalid values, their errors, and values that count as set."""

from __future__ import annotations

import pytest

from bridge.config.document import ConfigError
from bridge.config.load import loads
from bridge.config.model import Config

TOPIC = "topic: /scan, type: sensor_msgs/msg/LaserScan"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("yarp: {topics: [{topic: scan}]}", "names begin with a slash"),
        ("yarp: {topics: [{topic: /scan, port: 'la ser'}]}", "is not a name of a YARP port"),
        ("yarp: {topics: [{topic: /scan, port: '/la,ser'}]}", "is not a name of a YARP port"),
        ("yarp: {topics: [{topic: /scan, port: /laser:o}]}", "direction: in"),
        ("yarp: {topics: [{topic: /scan, port: /laser:o, direction: in}]}", "give the 'type'"),
        ("yarp: {topics: [{topic: /scan*, port: /laser:o, direction: out}]}", "is not a topic name"),
        ("yarp: {topics: [{topic: /scan*, type: std_msgs/msg/String}]}", "a rule with a 'type' is for one topic"),
        ("yarp: {topics: [{topic: /scan, type: std_msgs/String}]}", "is not a message type"),
        ("yarp: {topics: [{topic: /scan, as: fields}]}", "as: fields needs 'fields'"),
        ("yarp: {topics: [{topic: /scan, as: natural, fields: [x]}]}", "has 'fields'"),
        ("yarp: {topics: [{topic: /scan, fields: ['rad(x)']}]}", "is not a field"),
        ("yarp: {topics: [{topic: /scan, carrier: udp}]}", "'carrier' is for a connection"),
        ("yarp: {output: '/x:o'}", "is not a scheme of port names"),
        ("yarp: {output: '/a,b{topic}:o'}", "is not a scheme of port names"),
        ("yarp: {rpc: '/a{b{topic}:o'}", "is not a scheme of port names"),
        ("yarp: {output: '/x{topic}', input: '/x{topic}'}", "output, input and rpc must be three different names"),
        ("yarp: {address: robot}", "is not an address with a port"),
        ("yarp: {profile: yarp5}", "yarp3"),
        ("yarp: {ports: 20000}", "ports"),
        ("yarp: {ports: 80-90}", "is neither 'server' nor a range"),
        ("yarp: {ports: 20010-20000}", "is neither 'server' nor a range"),
        (
            f"yarp: {{topics: [{{{TOPIC}, port: /l, direction: in}}, {{{TOPIC}, port: /l, direction: in}}]}}",
            "names the port /l twice",
        ),
    ],
)
def test_invalid_values_are_refused(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words.replace("(", r"\(")):
        loads(text)


def test_valid_values_are_accepted() -> None:
    config = loads(
        "yarp: {topics: [{topic: /cmd_vel, port: /base:i, direction: out, fields: [3, linear.x, deg(angular.z), 1.5]},"
        " {topic: '**', as: natural}]}"
    )
    first, second = config.yarp.topics
    assert first.form == "fields"
    assert first.fields == (3, "linear.x", "deg(angular.z)", 1.5)
    assert (second.form, second.brings) == ("natural", False)


def test_set_keys_are_distinguished_from_defaults_after_a_json_round_trip() -> None:
    assert not Config.model_validate_json(Config().model_dump_json(by_alias=True)).yarp.configured
    parsed = loads("yarp: {poll: 1}")
    assert Config.model_validate_json(parsed.model_dump_json(by_alias=True)).yarp.configured
    assert not loads("yarp: {enabled: true}").yarp.configured


def test_the_range_of_ports_is_parsed() -> None:
    assert loads("yarp: {ports: 20000-20099}").yarp.numbers == range(20000, 20100)
    assert loads("yarp: {ports: server}").yarp.numbers == range(0)
    assert loads("yarp: {poll: 1}").yarp.numbers is None
