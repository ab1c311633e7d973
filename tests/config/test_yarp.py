"""The section ``yarp``: what is refused, with what words, and what counts as said."""

from __future__ import annotations

import pytest

from bridge.config import Config, loads
from bridge.config.problems import ConfigError

TOPIC = "topic: /scan, type: sensor_msgs/msg/LaserScan"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("yarp: {topics: [{topic: scan}]}", "names begin with a slash"),
        ("yarp: {topics: [{topic: /scan, port: 'la ser'}]}", "is no port name"),
        ("yarp: {topics: [{topic: /scan, port: /laser:o}]}", "direction: in"),
        ("yarp: {topics: [{topic: /scan, port: /laser:o, direction: in}]}", "give the 'type'"),
        ("yarp: {topics: [{topic: /scan*, port: /laser:o, direction: out}]}", "is no topic name"),
        ("yarp: {topics: [{topic: /scan*, type: std_msgs/msg/String}]}", "with a 'type' it is about one topic"),
        ("yarp: {topics: [{topic: /scan, type: std_msgs/String}]}", "is no message type"),
        ("yarp: {topics: [{topic: /scan, as: fields}]}", "as: fields needs 'fields'"),
        ("yarp: {topics: [{topic: /scan, as: natural, fields: [x]}]}", "has 'fields'"),
        ("yarp: {topics: [{topic: /scan, fields: ['rad(x)']}]}", "is no field"),
        ("yarp: {topics: [{topic: /scan, carrier: udp}]}", "'carrier' is for a connection"),
        ("yarp: {output: '/x:o'}", "is no scheme of port names"),
        ("yarp: {output: '/x{topic}', input: '/x{topic}'}", "output, input and rpc are not three names"),
        ("yarp: {address: robot}", "is no address with a port"),
        ("yarp: {profile: yarp5}", "yarp3"),
        (
            f"yarp: {{topics: [{{{TOPIC}, port: /l, direction: in}}, {{{TOPIC}, port: /l, direction: in}}]}}",
            "names the port /l twice",
        ),
    ],
)
def test_what_is_refused(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words.replace("(", r"\(")):
        loads(text)


def test_what_is_taken() -> None:
    config = loads(
        "yarp: {topics: [{topic: /cmd_vel, port: /base:i, direction: out, fields: [3, linear.x, deg(angular.z), 1.5]},"
        " {topic: '**', as: natural}]}"
    )
    first, second = config.yarp.topics
    assert first.form == "fields"
    assert first.fields == (3, "linear.x", "deg(angular.z)", 1.5)
    assert (second.form, second.brings) == ("natural", False)


def test_what_was_said_is_told_from_defaults_after_a_way_through_json() -> None:
    assert not Config.model_validate_json(Config().model_dump_json(by_alias=True)).yarp.configured
    said = loads("yarp: {poll: 1}")
    assert Config.model_validate_json(said.model_dump_json(by_alias=True)).yarp.configured
    assert not loads("yarp: {enabled: true}").yarp.configured
