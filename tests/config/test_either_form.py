"""Keys for one text or a list of texts accept both."""

from __future__ import annotations

import json
from typing import Any

import pytest

from bridge.config import generate, load
from bridge.config.document import ConfigError
from bridge.config.model import Config


def value(text: str, *path: str) -> Any:
    result: Any = load.loads(text)
    for name in path:
        result = getattr(result, name)
    return result


@pytest.mark.parametrize(
    ("text", "path", "expected"),
    [
        ("hub: {listen: 'tcp/127.0.0.1:7450'}", ("hub", "listen"), "tcp/127.0.0.1:7450"),
        ("hub: {listen: ['tcp/127.0.0.1:7450']}", ("hub", "listen"), "tcp/127.0.0.1:7450"),
        ("hub: {open: {listen: 'tls/0.0.0.0:7448'}}", ("hub", "open", "listen"), ("tls/0.0.0.0:7448",)),
        ("hub: {open: {listen: ['tls/0.0.0.0:7448']}}", ("hub", "open", "listen"), ("tls/0.0.0.0:7448",)),
        ("hub: {open: {connect: 'tls/r:7448', trusted: r}}", ("hub", "open", "connect"), ("tls/r:7448",)),
        ("hub: {open: {connect: 'tls/r:7448', trusted: '*'}}", ("hub", "open", "trusted"), ("*",)),
        ("hub: {listen: 'tcp/[::1]:7'}", ("hub", "listen"), "tcp/[::1]:7"),
        ("hub: {listen: 'tcp/localhost:7450#iface=lo'}", ("hub", "listen"), "tcp/localhost:7450#iface=lo"),
        ("hub: {listen: 'unixsock-stream//tmp/hub'}", ("hub", "listen"), "unixsock-stream//tmp/hub"),
        ("hub: {open: {connect: 'quic/r:7448?prio=1-3'}}", ("hub", "open", "connect"), ("quic/r:7448?prio=1-3",)),
        ("web: {listen: ['127.0.0.1:8080']}", ("web", "listen"), "127.0.0.1:8080"),
        ("metrics: {listen: ['127.0.0.1:9480']}", ("metrics", "listen"), "127.0.0.1:9480"),
        ("foxglove: {listen: ['127.0.0.1:8765']}", ("foxglove", "listen"), "127.0.0.1:8765"),
        ("record: {topics: /scan, sides: ros1}", ("record", "topics"), ("/scan",)),
        ("record: {topics: /scan, sides: ros1}", ("record", "sides"), ("ros1",)),
        ("foxglove: {origins: 'http://a'}", ("foxglove", "origins"), ("http://a",)),
    ],
)
def test_a_text_and_a_list_of_one_text_mean_the_same(text: str, path: tuple[str, ...], expected: Any) -> None:
    assert value(text, *path) == expected


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("hub: {listen: []}", "'listen' takes one address here, not 0"),
        ("hub: {listen: ['tcp/127.0.0.1:1', 'tcp/127.0.0.1:2']}", "'listen' takes one address here, not 2"),
        ("hub: {listen: [7447]}", "7447"),
        ("hub: {open: {listen: nonsense}}", "'nonsense' is not a zenoh endpoint"),
        (
            "hub: {listen: 'tcp/::1:7447'}",
            "'tcp/::1:7447' has no valid address; write it like tcp/robot1:7447 or tcp/[",
        ),
        ("hub: {open: {connect: 'tls/r:7448', trusted: 7}}", "7 is not a list"),
        ("hub: {open: {listen: 'tcp/0.0.0.0:7448'}}", "has no TLS"),
        ("record: {sides: ros3}", "ros3"),
        ("base_control: [1]", ""),
    ],
)
def test_other_values_are_refused(text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load.loads(text)
    assert problem in str(raised.value)
    assert "<text>:1:" in str(raised.value)


def test_a_text_in_an_item_of_a_list_becomes_a_list() -> None:
    planner = "{name: mine, side: ros1, action: /go, motion_actions: /spin}"
    (result,) = value(f"navigation: {{planners: [{planner}], planner: mine}}", "navigation", "planners")
    assert result.motion_actions == ("/spin",)


def test_the_schema_has_both_forms() -> None:
    result = json.loads(generate.schema())["$defs"]
    hub, opened = result["HubSection"]["properties"], result["OpenSection"]["properties"]
    assert [arm["type"] for arm in hub["listen"]["anyOf"]] == ["string", "array"]
    assert hub["listen"]["default"] == Config().hub.listen
    assert [arm["type"] for arm in opened["trusted"]["anyOf"]] == ["array", "string"]
    assert result["RoutingSection"]["properties"]["rules"]["type"] == "array"
