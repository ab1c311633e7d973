"""Names of topics and services."""

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
def test_names_come_apart(name: str, parts: tuple[str, str, str, str]) -> None:
    found = NestedName.parse(name)
    assert (found.topic, found.node, found.role, found.type) == parts
    assert found.port == name.partition("~")[0]
    assert found.is_topic == (found.role in (PUBLISHER, SUBSCRIBER))


def test_what_is_said_stays() -> None:
    name = NestedName.parse("/chatter+@/node")
    assert name.with_role(SUBSCRIBER) == name
    assert name.with_node("/other") == name
    assert NestedName.parse("/chatter@").with_role(PUBLISHER).with_node("/n").port == "/chatter+@/n"
