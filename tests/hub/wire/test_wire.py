"""Keys, names, attachments and QoS, as rmw_zenoh writes them."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.hub.errors import HubWireError
from bridge.hub.wire import keys
from bridge.hub.wire.keys import pack_attachment, unpack_attachment
from bridge.hub.wire.qos import BEST_AVAILABLE_NS, Durability, History, Qos, Reliability, decode_qos, encode_qos

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
GID = bytes(range(16))

QOS_TEXTS = [
    # the first three are announced by rmw_zenoh_cpp's demo talker, its demo listener and zenoh-ros2-sdk
    ("::,7:,:,:,,", Qos(depth=7)),
    ("::,10:,:,:,,", Qos(depth=10)),
    ("2:1:,1:,:,:,,", Qos(Reliability.BEST_EFFORT, Durability.TRANSIENT_LOCAL, depth=1)),
    ("::,:,:,:,,", Qos(depth=42)),
    ("::2,5:,:,:,,", Qos(history=History.KEEP_ALL, depth=5)),
    ("::,1:0,500000000:2,0:,,", Qos(depth=1, deadline_ns=500_000_000, lifespan_ns=2_000_000_000)),
]

QOS_READ = [
    ("1:2:1,10:,:,:,,", Qos(depth=10)),
    ("0:0:0,0:0,0:0,0:0,0,0", Qos(depth=0)),
    ("::,:9223372036,854775807:,:1,9223372036,854775807", Qos(depth=42)),
    ("::,:18446744073709551615,0:0,18446744073709551615:,,", Qos(depth=42)),
    # rmw's BEST_AVAILABLE, which a lifespan cannot have
    ("4::,10:,:,:,,", Qos(Reliability.BEST_AVAILABLE)),
    (":4:,10:,:,:5,,854775806", Qos(durability=Durability.BEST_AVAILABLE)),
    ("::,10:,854775806:,854775806:,,", Qos(deadline_ns=BEST_AVAILABLE_NS)),
    # policies that rmw does not define, and its UNKNOWN
    ("3:3:3,10:,:,:4,,", Qos()),
    ("9:5:7,10:,:,:77,,", Qos()),
    ("18446744073709551615::,10:,:,:,,", Qos()),
]

BAD_QOS = [
    "",
    ":::::",
    "::,10:,:,:",
    "::,10:,:,:,,:",
    "-1::,1:,:,:,,",
    ":x:,1:,:,:,,",
    "4.0::,1:,:,:,,",
    "111111111111111111111::,1:,:,:,,",
    "::,x:,:,:,,",
    "::,-1:,:,:,,",
    "::,٣:,:,:,,",
    "::,99999999999:,:,:,,",
]


@pytest.mark.parametrize(("text", "qos"), QOS_TEXTS)
def test_qos_is_encoded_as_rmw_zenoh_does(text: str, qos: Qos):
    assert encode_qos(qos) == text
    assert decode_qos(text) == qos


@pytest.mark.parametrize(("text", "qos"), QOS_READ)
def test_qos_text_of_other_implementations_is_decoded(text: str, qos: Qos):
    assert decode_qos(text) == qos


@pytest.mark.parametrize("text", BAD_QOS)
def test_invalid_qos_text_is_refused(text: str):
    with pytest.raises(HubWireError):
        decode_qos(text)


def test_a_deadline_of_best_available_is_written_as_rmw_does():
    assert encode_qos(Qos(deadline_ns=BEST_AVAILABLE_NS)) == "::,10:,854775806:,:,,"


TIMES = st.none() | st.integers(1, 9_223_372_035 * 10**9)


@given(
    st.builds(
        Qos,
        st.sampled_from(Reliability),
        st.sampled_from(Durability),
        st.sampled_from(History),
        st.integers(0, 2**31 - 1),
        TIMES,
        TIMES,
    )
)
def test_qos_survives_the_round_trip(qos: Qos):
    assert decode_qos(encode_qos(qos)) == qos


@given(st.text(alphabet="0123456789:,x-", max_size=40))
def test_qos_of_any_text_is_decoded_or_refused(text: str):
    with contextlib.suppress(HubWireError):
        assert isinstance(decode_qos(text), Qos)


def test_attachments_have_the_bytes_of_rmw_zenoh():
    """The bytes are those of zenoh-ros2-sdk, and of rmw_zenoh since Jazzy's 0.2.4."""
    data = pack_attachment(1, 0x0102, GID)
    assert data == b"\1" + bytes(7) + b"\2\1" + bytes(6) + b"\x10" + GID
    assert unpack_attachment(data) == (1, 0x0102, GID)


@pytest.mark.parametrize("data", [b"", bytes(32), bytes(34), bytes(16) + b"\x0f" + GID])
def test_malformed_attachments_are_rejected(data: bytes):
    with pytest.raises(HubWireError):
        unpack_attachment(data)


@given(st.binary(max_size=80))
def test_an_attachment_of_any_bytes_is_unpacked_or_refused(data: bytes):
    with contextlib.suppress(HubWireError):
        assert pack_attachment(*unpack_attachment(data)) == data


def test_keys_of_topics_are_those_of_rmw_zenoh():
    key = keys.topic_key(5, "/chatter", "std_msgs/msg/String", STRING_HASH)
    assert key == f"5/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    assert keys.subscription_key(0, "/a/b", "x/srv/Y", "*") == "0/a/b/x::srv::dds_::Y_/*"


@pytest.mark.parametrize(
    "topic",
    [
        "",
        "/",
        "chatter",
        "/a//b",
        "/a/",
        "/a b",
        "/a*",
        "/**",
        "/a$b",
        "/a?b",
        "/a#b",
        "/@a",
        "/a/@b",
        "/a%b",
        "/a\n",
        "/" + "a" * 2000,
    ],
)
def test_a_topic_that_cannot_be_part_of_a_key_is_refused(topic: str):
    with pytest.raises(HubWireError):
        keys.topic_key(0, topic, "std_msgs/msg/String", STRING_HASH)


@pytest.mark.parametrize("name", ["std_msgs/String", "std_msgs/msg/", "/msg/X", "a/msg/B/C", "a/msg/*", "a/msg/Ä", ""])
def test_a_type_that_cannot_be_part_of_a_key_is_refused(name: str):
    with pytest.raises(HubWireError):
        keys.topic_key(0, "/t", name, STRING_HASH)


@pytest.mark.parametrize(
    "type_hash", [" ", "*", "md5", "TypeHashNotSupported", "RIHS01_", "RIHS01_XY", "RIHS01_00/..", "**"]
)
def test_a_hash_that_cannot_be_part_of_a_key_is_refused(type_hash: str):
    with pytest.raises(HubWireError):
        keys.topic_key(0, "/t", "std_msgs/msg/String", type_hash)


@pytest.mark.parametrize(
    ("ros", "dds"),
    [
        ("std_msgs/msg/String", "std_msgs::msg::dds_::String_"),
        ("nav2_msgs/action/Spin_SendGoal", "nav2_msgs::action::dds_::Spin_SendGoal_"),
        ("a/srv/B_Request", "a::srv::dds_::B_Request_"),
    ],
)
def test_type_names_are_converted_to_dds_and_back(ros: str, dds: str):
    assert keys.dds_type_name(ros) == dds
    assert keys.ros_type_name(dds) == ros


@pytest.mark.parametrize("dds", ["", "std_msgs::msg::String", "std_msgs::msg::dds_::String", "a::b::dds_::C_"])
def test_an_invalid_dds_name_is_refused(dds: str):
    with pytest.raises(HubWireError):
        keys.ros_type_name(dds)
