"""The user's zenoh configuration is merged into Midspan's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.errors import HubConfigError
from bridge.hub.session import HubSettings
from bridge.hub.zenoh_config import connect_endpoint, make_config, session_tree

TREE = session_tree("tcp/127.0.0.1:1", shared_memory=True, max_payload=1 << 20)


def value(config: Any, key: str) -> Any:
    return json.loads(config.get_json(key))


def test_the_default_configuration_is_a_peer_of_the_router():
    config = make_config(TREE, None)
    assert value(config, "mode") == "peer"
    assert value(config, "scouting/multicast/enabled") is False
    assert value(config, "connect/endpoints") == ["tcp/127.0.0.1:1"]
    assert value(config, "listen/endpoints") == ["tcp/127.0.0.1:0"]
    assert value(config, "transport/shared_memory/enabled") is True


def test_inline_settings_override_defaults():
    config = make_config(TREE, {"mode": "client", "transport": {"link": {"tx": {"lease": 9000}}}})
    assert value(config, "mode") == "client"
    assert value(config, "transport/link/tx/lease") == 9000
    assert value(config, "transport/link/tx/keep_alive") == 4
    assert value(config, "scouting/multicast/enabled") is False


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("z.json5", "{ // a comment\n mode: 'client', connect: { endpoints: ['tcp/10.0.0.1:7447'], }, }"),
        ("z.yaml", "mode: client\nconnect:\n  endpoints: [tcp/10.0.0.1:7447]\n"),
    ],
)
def test_file_settings_override_defaults(tmp_path: Path, name: str, text: str):
    (tmp_path / name).write_text(text)
    config = make_config(TREE, tmp_path / name)
    assert value(config, "mode") == "client"
    assert value(config, "connect/endpoints") == ["tcp/10.0.0.1:7447"]
    assert value(config, "connect/exit_on_failure")["peer"] is False
    assert value(config, "scouting/multicast/enabled") is False


@pytest.mark.parametrize("user", [{"mod": "peer"}, {"mode": "king"}, {"mode": {1, 2}}, "/nonexistent/zenoh.json5"])
def test_invalid_settings_are_refused(user: Any):
    with pytest.raises(HubConfigError, match="zenoh configuration"):
        make_config(TREE, user)


@pytest.mark.parametrize(
    ("listen", "connect"),
    [
        ("tcp/0.0.0.0:7447", "tcp/127.0.0.1:7447"),
        ("tcp/[::]:7447", "tcp/[::1]:7447"),
        ("tls/robot:7447", "tls/robot:7447"),
    ],
)
def test_a_router_on_all_interfaces_is_reached_on_loopback(listen: str, connect: str):
    assert connect_endpoint(listen) == connect


@pytest.mark.parametrize(
    "names", [{"daemon": "a/b"}, {"worker": "*"}, {"node": "1x"}, {"node": "a/b"}, {"namespace": "x"}, {"daemon": ""}]
)
def test_names_that_cannot_be_part_of_a_key_are_refused(names: dict[str, str]):
    with pytest.raises(HubConfigError):
        HubSettings(**names)  # type: ignore[arg-type]
