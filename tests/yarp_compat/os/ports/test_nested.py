"""ROS names of topics and services."""

from __future__ import annotations

import pytest

from yarp_compat.os.ports.nested import CLIENT, PUBLISHER, SERVER, SUBSCRIBER, NestedName


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("/chatter@/node", ("/chatter", "/node", "", "")),
        ("/chatter+@/node", ("/chatter", "/node", PUBLISHER, "")),
        ("/chatter-@/node", ("/chatter", "/node", SUBSCRIBER, "")),
        ("/add-1@/node", ("/add", "/node", SERVER, "")),
        ("/add+1@/node", ("/add", "/node", CLIENT, "")),
        ("/add1@/node", ("/add1", "/node", "", "")),
        ("/chatter+@/node~std_msgs/String", ("/chatter", "/node", PUBLISHER, "std_msgs/String")),
        ("/chatter@", ("/chatter", "", "", "")),
        ("/reader", ("", "/reader", "", "")),
        ("/minus-1", ("", "/minus-1", "", "")),
    ],
)
def test_names_are_split(name: str, parts: tuple[str, str, str, str]) -> None:
    nested = NestedName.parse(name)
    assert (nested.topic, nested.node, nested.role, nested.type) == parts
    assert nested.port == name.partition("~")[0]
    assert nested.is_topic == (nested.role in (PUBLISHER, SUBSCRIBER))


def test_given_parts_are_kept() -> None:
    name = NestedName.parse("/chatter+@/node")
    assert name.with_role(SUBSCRIBER) == name
    assert name.with_node("/other") == name
    assert NestedName.parse("/chatter@").with_role(PUBLISHER).with_node("/n").port == "/chatter+@/n"
