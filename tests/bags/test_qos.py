"""QoS profiles in the metadata of bags: unspecified policies, and values that rmw does not define."""

from __future__ import annotations

import io
import logging
from pathlib import Path

import pytest
from mcap.writer import Writer

from bridge.bags import qos as bag_qos
from bridge.bags.qos import merged_qos, parse_qos, qos_yaml
from bridge.bags.reader import open_bag
from bridge.hub.wire.qos import Durability, History, Qos, Reliability

OPEN = """- history: {history}
  depth: 10
  reliability: {reliability}
  durability: {durability}
  deadline:
    sec: 9223372036
    nsec: 854775806
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: {liveliness}
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775806
  avoid_ros_namespace_conventions: false
"""
NAMES = OPEN.format(
    history="keep_last", reliability="best_available", durability="best_available", liveliness="best_available"
)
NUMBERS = OPEN.format(history=1, reliability=4, durability=4, liveliness=5)
RESOLVED = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL)


@pytest.fixture(autouse=True)
def _nothing_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bag_qos, "_unknown", set(), raising=False)


def records(caplog: pytest.LogCaptureFixture) -> list[logging.LogRecord]:
    """Return the records of the tested module; threads of earlier tests may add others."""
    return [record for record in caplog.records if record.name == bag_qos.__name__]


@pytest.mark.parametrize("text", [NAMES, NUMBERS])
def test_best_available_is_resolved_as_for_a_publisher(text: str, caplog: pytest.LogCaptureFixture) -> None:
    assert parse_qos(text) == (RESOLVED,)
    assert parse_qos(qos_yaml(parse_qos(text))) == (RESOLVED,)
    assert merged_qos(parse_qos(text)) == RESOLVED
    assert not records(caplog)


@pytest.mark.parametrize("text", [NAMES, NUMBERS])
def test_best_available_in_a_bag_is_resolved(text: str, tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start("ros2", "test")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
    channel = writer.register_channel("/a", "cdr", schema, {"offered_qos_profiles": text})
    writer.add_message(channel, 1, b"\0\1\0\0\2\0\0\0a\0", 1)
    writer.finish()
    path = tmp_path / "open.mcap"
    path.write_bytes(stream.getvalue())
    with open_bag(path) as bag:
        assert [topic.qos for topic in bag.topics] == [RESOLVED]


@pytest.mark.parametrize("value", ["fast", "7", "-1", "1.5", "99999999999999999999"])
@pytest.mark.parametrize("policy", ["reliability", "durability", "history"])
def test_an_unknown_value_takes_the_default_with_one_warning(
    policy: str, value: str, caplog: pytest.LogCaptureFixture
) -> None:
    text = f"- {policy}: {value}\n  depth: 10\n"
    with caplog.at_level(logging.WARNING):
        assert parse_qos(text + text) == parse_qos(text) == (Qos(),)
    assert len(records(caplog)) == 1
    assert f"{policy} policy" in caplog.text
    assert value in caplog.text


def test_nested_aliases_that_expand_exponentially_are_not_expanded(caplog: pytest.LogCaptureFixture) -> None:
    lists = "\n".join(f"- &l{n} [{', '.join([f'*l{n - 1}'] * 10)}]" for n in range(1, 30))
    text = f"- &l0 [x]\n{lists}\n- reliability: *l29\n  depth: 10\n"
    assert parse_qos(text) == (Qos(),)
    assert "of type list" in caplog.text


def test_what_rmw_leaves_unset_needs_no_warning(caplog: pytest.LogCaptureFixture) -> None:
    """Fast DDS reports each publisher's history as UNKNOWN, so most bags contain it."""
    for values in (("unknown", "system_default", "unknown", "automatic"), (3, 0, 3, 1)):
        history, reliability, durability, liveliness = values
        text = OPEN.format(history=history, reliability=reliability, durability=durability, liveliness=liveliness)
        assert parse_qos(text) == (Qos(history=History.KEEP_LAST),)
    assert not records(caplog)


def test_many_unknown_values_do_not_flood_the_log(caplog: pytest.LogCaptureFixture) -> None:
    for number in range(100, 400):
        assert parse_qos(f"- reliability: {number}\n  depth: 10\n") == (Qos(),)
    assert len(records(caplog)) <= 100
