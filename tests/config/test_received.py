"""A worker's configuration, whose sections are parsed when first used."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pydantic import ValidationError

from bridge.config.model import Config
from bridge.config.received import ReceivedConfig
from bridge.daemon.protocol import NewConfig, config_json, decode_command, encode_command
from bridge.record.section import RecordSection
from navigation.base_control.section import BaseControlSection

CONFIG: dict[str, Any] = {
    "name": "here",
    "state": "/tmp/here",
    "hub": {"domain": 7, "zenoh": {"mode": "client"}},
    "routing": {"rules": [{"topic": "/a", "from": "ros1", "rename": "/b"}]},
    "navigation": {"planner": "nav2"},
    "modules": {"base_control": {"enabled": True, "wheel_command": "/wheels"}},
    "record": {"topics": ["/scan"]},
}


def data(**changes: Any) -> dict[str, Any]:
    sent: dict[str, Any] = json.loads(json.dumps(config_json(Config.model_validate({**CONFIG, **changes}))))
    return sent


@pytest.fixture
def received() -> ReceivedConfig:
    return ReceivedConfig.of(data())


def test_each_part_is_the_same_as_in_the_checked_configuration(received: ReceivedConfig) -> None:
    checked = Config.model_validate(CONFIG)
    for name in Config.model_fields:
        assert getattr(received, name) == getattr(checked, name), name
    for view in ("rules", "hosted"):
        assert getattr(received, view) == getattr(checked, view), view
    for model in (RecordSection, BaseControlSection):
        assert received.section(model) == checked.section(model)


def test_a_section_is_built_when_it_is_used(received: ReceivedConfig) -> None:
    assert set(received.__dict__) == {"version", "name", "state"}
    section = received.hub
    assert set(received.__dict__) == {"version", "name", "state", "hub"}
    assert received.hub is section
    with pytest.raises(AttributeError, match="'hubs'"):
        getattr(received, "hubs")  # noqa: B009


def test_the_rules_of_a_side_need_only_their_sections() -> None:
    """The others cost a worker tens of milliseconds at its start."""
    checked = Config.model_validate(CONFIG)
    command = decode_command(encode_command(NewConfig(checked)), ReceivedConfig.of)
    assert isinstance(command, NewConfig)
    rules = command.config.rules
    assert set(command.config.__dict__) == {"version", "name", "state", "routing", "navigation"}
    assert rules == checked.rules
    assert "/wheels" in {rule.topic for rule in rules.rules}


def test_configurations_are_compared_by_their_values(received: ReceivedConfig) -> None:
    checked = Config.model_validate(CONFIG)
    assert received == checked
    assert checked == received
    assert received == ReceivedConfig.of(data())
    assert received != ReceivedConfig.of(data(name="there"))
    assert received != Config.model_validate({**CONFIG, "log": {"level": "debug"}})
    assert received != CONFIG


def test_a_copy_has_the_change_and_all_other_sections(received: ReceivedConfig) -> None:
    copy = received.model_copy(update={"hub": received.hub.model_copy(update={"lane": False})})
    assert (copy.hub.lane, copy.hub.domain, received.hub.lane) == (False, 7, True)
    assert copy.section(RecordSection).topics == ("/scan",)
    assert copy != received


def test_a_received_configuration_is_dumped_in_full(received: ReceivedConfig) -> None:
    assert config_json(received) == data()
    assert Config.model_validate_json(received.model_dump_json(by_alias=True)) == received
    assert dict(ReceivedConfig.of(data())) == dict(Config.model_validate(CONFIG))


def test_an_invalid_section_is_reported_when_it_is_used() -> None:
    received = ReceivedConfig.of({**data(), "hub": {"domain": "x"}})
    with pytest.raises(ValidationError, match="domain"):
        received.hub  # noqa: B018
