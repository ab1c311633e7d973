"""Liveliness tokens are written, parsed and refused."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.hub.errors import HubWireError
from bridge.hub.graph.tokens import (
    UNKNOWN_HASH,
    EndpointKind,
    EndpointToken,
    NodeToken,
    Origin,
    OriginToken,
    driver_key,
    endpoint_key,
    gid_of,
    node_key,
    origin_key,
    parse_driver,
    parse_origin,
    parse_token,
    parse_velocity,
    qos_text,
    velocity_key,
)
from bridge.hub.wire.keys import NO_HASH
from bridge.hub.wire.qos import Qos

HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
TALKER = (
    "@ros2_lv/0/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter"
    f"/std_msgs::msg::dds_::String_/{HASH}/::,7:,:,:,,"
)
LISTENER = "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"


def test_the_token_of_rmw_zenohs_demo_talker_is_parsed():
    """Parse the token that rmw_zenoh_cpp's demo talker declares."""
    token = parse_token(TALKER)
    owner = NodeToken(0, "8b20917502ee955ac4476e0266340d5c", "0", "/", "talker")
    assert token == EndpointToken(
        owner, "10", EndpointKind.PUBLISHER, "/chatter", "std_msgs/msg/String", HASH, Qos(depth=7)
    )
    assert endpoint_key(token) == TALKER
    assert node_key(parse_token(LISTENER)) == LISTENER  # type: ignore[arg-type]


def test_a_gid_is_the_hash_of_its_token():
    """A GID is the plain XXH3-128 of the key, low half first."""
    assert gid_of(LISTENER).hex() == "5bd72f4daf53c0bb00c7394e7fc19547"
    assert gid_of(TALKER).hex() == "eb85fa883b7846dc448a4501890ad062"


@pytest.mark.parametrize("kind", EndpointKind)
def test_endpoint_tokens_survive_the_round_trip(kind: EndpointKind):
    owner = NodeToken(42, "abc1", "3", "/a/b", "node_1", "/enclave/x")
    token = EndpointToken(owner, "77", kind, "/very/deep/name", "a_msgs/srv/B", HASH, Qos(depth=1))
    assert parse_token(endpoint_key(token)) == token
    assert parse_token(node_key(owner)) == replace(owner)


def test_subscription_to_any_hash_has_a_token():
    owner = NodeToken(0, "abc1", "0", "/", "n")
    token = EndpointToken(owner, "1", EndpointKind.SUBSCRIPTION, "/t", "a/msg/B", "*", Qos())
    assert UNKNOWN_HASH in endpoint_key(token)


WORDS = st.text(st.characters(codec="utf-8"), max_size=30)


@given(WORDS, WORDS, WORDS)
def test_origin_tokens_survive_the_round_trip_as_legal_keys(side: str, network: str, daemon: str):
    token = OriginToken(5, "abc", Origin(side, network, daemon))
    key = origin_key(token)
    assert parse_origin(key) == token
    assert not set("*$?#") & set(key)
    assert "//" not in key


BAD_TOKENS = [
    "",
    "@ros2_lv",
    "ros2_lv/0/a/0/0/NN/%/%/n",
    "@ros2_lv/x/a/0/0/NN/%/%/n",
    "@ros2_lv/0/a/0/0/NN/%/%",
    "@ros2_lv/0/a/0/0/XX/%/%/n",
    "@ros2_lv/0/a/0/1/MP/%/%/n",
    "@ros2_lv/0//0/0/NN/%/%/n",
    TALKER.rpartition("/")[0],
    TALKER.replace("::,7:", "::,7"),
    TALKER.replace("std_msgs::msg", "std_msgs"),
    TALKER.replace("/MP/", "/ZZ/"),
    TALKER.replace("talker", "t" * 5000),
    TALKER.replace("%chatter", "%chat ter"),
    TALKER.replace("%chatter", "%chat%%ter"),
    TALKER.replace("%chatter", "%"),
]


@pytest.mark.parametrize("more", ["backends:cpu:", "backends:cpu:;cuda:device=0", "backends:cpu:/and/what/comes/later"])
def test_additions_of_a_later_release_to_a_token_are_ignored(more: str):
    """rmw_zenoh_cpp 0.10.5 (Lyrical) appends ``backends:cpu:`` for volatile endpoints of Image and PointCloud2."""
    key = f"{TALKER}/{more}"
    assert parse_token(key) == parse_token(TALKER)
    assert qos_text(key) == qos_text(TALKER) == "::,7:,:,:,,"
    assert gid_of(key) != gid_of(TALKER)


def test_a_token_without_a_type_hash_is_parsed():
    """Humble's rmw_zenoh writes a word in place of the hash, because Humble's types have no hash."""
    key = TALKER.replace(HASH, "TypeHashNotSupported")
    token = parse_token(key)
    assert isinstance(token, EndpointToken)
    assert token.type_hash == NO_HASH
    assert endpoint_key(token) == key


@pytest.mark.parametrize("key", BAD_TOKENS)
def test_malformed_tokens_are_rejected(key: str):
    with pytest.raises(HubWireError):
        parse_token(key)


def test_velocity_tokens_survive_the_round_trip():
    key = velocity_key(5, "abc", "/robot_1/cmd_vel", "geometry_msgs/msg/Twist")
    assert parse_velocity(key) == ("abc", "/robot_1/cmd_vel", "geometry_msgs/msg/Twist")


@given(WORDS)
def test_driver_tokens_survive_the_round_trip_as_legal_keys(who: str):
    key = driver_key(5, "abc", "/robot_1/cmd_vel", who)
    assert parse_driver(key) == ("abc", "/robot_1/cmd_vel", who)
    assert not set("*$?#") & set(key)
    assert "//" not in key


@pytest.mark.parametrize(
    "topic", ["", "/", "cmd_vel", "/*/cmd_vel", "/**", "/cmd vel", "//cmd_vel", "/a$*", "/@midspan"]
)
def test_a_velocity_token_with_a_malformed_topic_is_refused(topic: str):
    with pytest.raises(HubWireError):
        parse_velocity(velocity_key(5, "abc", topic, "geometry_msgs/msg/Twist"))


@pytest.mark.parametrize("type_name", ["", "Twist", "geometry_msgs/Twist", "geometry_msgs/msg/*"])
def test_a_velocity_token_with_a_malformed_type_is_refused(type_name: str):
    with pytest.raises(HubWireError):
        parse_velocity(velocity_key(5, "abc", "/cmd_vel", type_name))


@pytest.mark.parametrize(
    "key", ["", "@midspan/0/origin/a/b/c", "@midspan/0/other/a/b/c/d", "@midspan/x/origin/a/b/c/d"]
)
def test_malformed_origins_are_rejected(key: str):
    with pytest.raises(HubWireError):
        parse_origin(key)


PARTS = st.lists(
    st.sampled_from(
        [
            "@ros2_lv",
            "@midspan",
            "origin",
            "0",
            "7",
            "MP",
            "NN",
            "%",
            "%a%b",
            HASH,
            "a::msg::dds_::B_",
            "::,:,:,:,,",
            "",
            "x",
        ]
    )
    | st.text(max_size=8),
    max_size=16,
)


@given(PARTS)
def test_a_token_of_any_text_is_parsed_or_refused(parts: list[str]):
    for parse in (parse_token, parse_origin):
        assert_refused_or_kept(parse, "/".join(parts))


def assert_refused_or_kept(parse: Callable[[str], Any], key: str) -> None:
    """Check that any token that can be parsed is the same after writing and parsing it again."""
    with contextlib.suppress(HubWireError):
        token = parse(key)
        write: Any = {NodeToken: node_key, EndpointToken: endpoint_key, OriginToken: origin_key}[type(token)]
        assert parse(write(token)) == token


@given(st.integers(0, 12), st.text(max_size=20))
def test_a_token_with_one_part_changed_is_parsed_or_refused(index: int, text: str):
    parts = TALKER.split("/")
    parts[index] = text
    assert_refused_or_kept(parse_token, "/".join(parts))
