"""The sections of the configuration for which each worker and each module is reloaded."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.config.model import Config
from bridge.daemon.workers import worker_kinds

CHANGES: dict[str, dict[str, Any]] = {
    "name": {"name": "other"},
    "state": {"state": "/tmp/other"},
    "hub": {"hub": {"domain": 7}},
    "hub.open": {"hub": {"open": {"listen": ["tls/0.0.0.0:7448"], "trusted": ["operator1"]}}},
    "ros1": {"ros1": {"master": "http://other:11311"}},
    "ros2": {"ros2": {"domain": 7}},
    "zenoh": {"zenoh": {"enabled": False}},
    "yarp": {"yarp": {"namespace": "/other"}},
    "modules": {"modules": {"mapper2d": {"enabled": True}}},
    "sim": {"sim": {"seed": 7}},
    "store": {"store": {"enabled": True}},
    "clock": {"clock": {"source": "sim"}},
    "types": {"types": {"folders": ["/tmp"]}},
    "routing": {"routing": {"default": "deny"}},
    "navigation": {"navigation": {"velocity": "/other/cmd_vel"}},
    "record": {"record": {"queue": 7}},
    "web": {"web": {"radius": 0.7}},
    "foxglove": {"foxglove": {"drive": True}},
    "metrics": {"metrics": {"routes": 7}},
    "limits": {"limits": {"message": 7}},
    "log": {"log": {"level": "debug"}},
}
ALL = {"name", "state", "hub", "log"}
SIDE = {*ALL, "types", "limits", "routing", "navigation", "metrics", "modules", "clock"}
USES = {
    "router": {*ALL, "hub.open"},
    "ros1_master": {*ALL, "ros1"},
    "ros1": {*SIDE, "ros1"},
    "ros2": {*SIDE, "ros2"},
    "yarp": {*SIDE, "yarp"},
    "zenoh": {*SIDE, "zenoh"},
    "modules": {*ALL, "modules", "navigation", "store", "types", "limits", "yarp", "metrics", "clock"},
    "sim": {*ALL, "sim", "clock", "types", "limits", "yarp"},
    "record": {*ALL, "record", "clock", "types", "limits", "yarp"},
    "web": {*ALL, "web", "metrics", "navigation", "modules", "types", "limits", "clock", "routing"},
    "foxglove": {
        *ALL, "foxglove", "web", "metrics", "navigation", "modules", "types", "limits", "clock", "routing",
    },
    "metrics": {*ALL, "metrics", "web", "clock", "types", "modules", "navigation"},
}  # fmt: skip
TOKEN = {"web": {"tokens": {"anna": {"sha256": "0" * 64}}}}


def merge(base: dict[str, Any], change: dict[str, Any]) -> Config:
    sections = {key: {**base.get(key, {}), **value} for key, value in change.items() if isinstance(value, dict)}
    return Config.model_validate({"name": "here", "state": "/tmp/here", **base, **change, **sections})


def changes_that_reload(worker: str, base: dict[str, Any]) -> set[str]:
    """Return the configuration changes for which a worker is reloaded."""
    kind, before = worker_kinds({})[worker], merge(base, {})
    return {
        name for name, change in CHANGES.items() if kind.config_part(merge(base, change)) != kind.config_part(before)
    }


def test_every_section_and_every_worker_is_listed() -> None:
    assert {name.partition(".")[0] for name in CHANGES} == set(Config.model_fields) - {"version"}
    assert list(worker_kinds({})) == list(USES)


@pytest.mark.parametrize("worker", USES)
def test_a_worker_reloads_for_the_sections_that_it_uses(worker: str) -> None:
    assert changes_that_reload(worker, {}) == USES[worker]


def test_the_router_of_an_open_hub_reloads_for_rules_too() -> None:
    opened = CHANGES["hub.open"]
    assert changes_that_reload("router", opened) == {*ALL, "routing"}
    planner = merge(opened, {"navigation": {"planner": "nav2", "velocity": "/other/cmd_vel"}})
    router = worker_kinds({})["router"]
    assert router.config_part(planner) != router.config_part(merge(opened, {}))


@pytest.mark.parametrize("worker", [worker for worker in USES if worker != "router"])
def test_a_server_with_a_login_reloads_for_the_certificate_of_the_hub(worker: str) -> None:
    before, after = merge(TOKEN, {}), merge(TOKEN, {"hub": {"open": {"key": "/tmp/other.key"}}})
    kind = worker_kinds({})[worker]
    assert (kind.config_part(before) != kind.config_part(after)) == (worker in ("web", "metrics"))


def test_workers_are_enabled_by_their_own_key() -> None:
    enabled = {name: kind.enabled(Config()) for name, kind in worker_kinds({}).items()}
    off = dict.fromkeys(("modules", "sim", "record", "web", "foxglove", "metrics"), False)
    assert {name: enabled[name] for name in ("router", "ros1", "ros2", *off)} == {
        "router": "auto", "ros1": "auto", "ros2": "auto", **off,
    }  # fmt: skip
    for name in ("sim", "record", "web", "foxglove", "metrics"):
        assert worker_kinds({})[name].enabled(merge({}, {name: {"enabled": True}})) is True
    router = worker_kinds({})["router"]
    assert router.enabled(merge({}, {"hub": {"router": False}})) is False
    modules = worker_kinds({})["modules"]
    assert modules.enabled(merge({}, CHANGES["modules"])) == "auto"
    assert modules.enabled(merge({}, {"navigation": {"planner": "nav2"}})) == "auto"
    assert modules.enabled(merge({}, {**CHANGES["store"], "modules": {"enabled": False}})) is False


MODULES = (
    "base_control", "control_boards", "localization_server", "map2d_server", "mapper2d", "mapper3d", "robot_goto",
    "robot_path_planner", "transform_server",
)  # fmt: skip
OF_NAVIGATION = {
    "map": {"gateway", "localization_server", "robot_path_planner"},
    "localizer": {"gateway", "localization_server"},
}
"""Keys of ``navigation``, each with the modules whose sections inherit it."""


def running(change: dict[str, Any]) -> Config:
    enabled = {name: {"enabled": True} for name in MODULES}
    return merge({"modules": enabled, "navigation": {"planner": "nav2"}}, change)


def test_a_module_restarts_for_its_own_section() -> None:
    before = running({})
    assert set(before.hosted) == {*MODULES, "gateway"}
    for name in MODULES:
        after = running({"modules": {name: {"enabled": False}}}).hosted
        assert set(after) == set(before.hosted) - {name}
        assert all(after[other] == before.hosted[other] for other in after)


@pytest.mark.parametrize(("key", "value"), [("map", "/other/map"), ("localizer", "amcl")])
def test_a_module_restarts_for_keys_of_navigation_that_it_inherits(key: str, value: str) -> None:
    before, after = running({}).hosted, running({"navigation": {"planner": "nav2", key: value}}).hosted
    assert {name for name in after if after[name] != before[name]} == OF_NAVIGATION[key]
