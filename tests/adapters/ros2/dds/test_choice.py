"""Which DDS implementation a worker uses, and what each can and reports; without a participant."""

from __future__ import annotations

import pytest

from bridge.adapters.ros2 import filters
from bridge.adapters.ros2.context import Dds
from bridge.adapters.ros2.dds.choice import dds_of
from bridge.adapters.ros2.dds.cyclone import CycloneDds
from bridge.adapters.ros2.dds.fast import FastDds
from bridge.config.model import Config
from bridge.messages.errors import MessageTypeError
from bridge.routing.edge import Endpoint, Kind
from tests.adapters.ros2.graph.test_vendors import CYCLONE, FAST, endpoint

CLIENT = endpoint(FAST, Kind.CLIENT, topic="/ours", node="/asker")


def dds(rmw: str) -> Dds:
    return dds_of(Config.model_validate({"ros2": {"rmw": rmw, "domain": 7}}))


def test_the_configuration_chooses() -> None:
    assert isinstance(dds("rmw_fastrtps_cpp"), FastDds)
    assert isinstance(dds("rmw_cyclonedds_cpp"), CycloneDds)
    assert isinstance(dds_of(Config()), FastDds)


@pytest.mark.parametrize("separates", [True, False])
def test_on_fast_dds_servers_of_both_are_an_obstacle_only_without_the_filter(
    separates: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(filters, "is_available", lambda: separates)
    fast, both = dds("rmw_fastrtps_cpp"), [endpoint(FAST), endpoint(CYCLONE)]
    assert fast.separates_versions() is separates
    assert (fast.obstacle("/lamp", both) is None) is separates
    assert fast.obstacle("/lamp", both[:1]) is None
    assert fast.obstacle("/lamp", both[1:]) is None


def test_on_fast_dds_names_on_both_are_reported() -> None:
    fast, both = dds("rmw_fastrtps_cpp"), [endpoint(FAST), endpoint(CYCLONE), CLIENT]
    assert fast.details(both) == {"cyclone": {"nodes": ["/of_0110"], "both": ["/lamp"], "mixed": []}}
    assert fast.details(both[:1]) == {}
    (warning,) = fast.warnings(both, {"/ours"})
    assert "the servers on Cyclone DDS are not called" in warning
    assert fast.warnings(both[1:], {"/ours"}) == []
    assert list(fast.notes(both)) == ["/lamp"]


def test_on_cyclone_dds_servers_on_another_are_an_obstacle() -> None:
    cyclone = dds("rmw_cyclonedds_cpp")
    assert not cyclone.separates_versions()
    assert cyclone.obstacle("/lamp", [endpoint(CYCLONE)]) is None
    assert cyclone.obstacle("/lamp", []) is None
    for servers in ([endpoint(FAST)], [endpoint(CYCLONE), endpoint(FAST)]):
        obstacle = cyclone.obstacle("/lamp", servers)
        assert obstacle is not None
        assert "/lamp is served on a DDS other than Cyclone DDS (/of_010f)" in obstacle.reason
        assert "remove ros2.rmw" in obstacle.cure


def reported(*endpoints: Endpoint, served: set[str]) -> tuple[dict[str, list[str]], list[str]]:
    """Return the details and the warnings of a worker on Cyclone DDS."""
    cyclone = dds("rmw_cyclonedds_cpp")
    assert cyclone.notes(endpoints) == {}
    return cyclone.details(endpoints)["cyclone"], cyclone.warnings(endpoints, served)


def test_on_cyclone_dds_what_cannot_be_reached_is_reported() -> None:
    parameters = endpoint(FAST, topic="/quiet/get_parameters", type="rcl_interfaces/srv/GetParameters", node="/quiet")
    details, warnings = reported(endpoint(CYCLONE), endpoint(FAST), parameters, CLIENT, served={"/ours"})
    assert details == {
        "nodes": ["/of_0110"], "both": [], "mixed": [], "foreign": ["/of_010f", "/quiet"], "uncallable": ["/lamp"],
    }  # fmt: skip
    assert [text.partition(";")[0] for text in warnings] == [
        "/lamp: served on a DDS other than Cyclone DDS, so they cannot be called",
        "/ours: /asker on a DDS other than Cyclone DDS may call them, but gets no replies",
    ]


def test_on_cyclone_dds_there_are_no_other_warnings() -> None:
    parameters = endpoint(FAST, topic="/quiet/get_parameters", type="rcl_interfaces/srv/GetParameters")
    assert reported(endpoint(CYCLONE), parameters, CLIENT, served={"/others"})[1] == []
    assert reported(served=set()) == ({"nodes": [], "both": [], "mixed": [], "foreign": [], "uncallable": []}, [])


def test_services_on_cyclone_dds_need_the_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it, rcl's wait set serves the readers, and rejects those of rmw."""
    types = dds("rmw_cyclonedds_cpp").types
    monkeypatch.setattr("bridge.adapters.ros2.types.is_compiled", lambda: True)
    types.prepare_services()
    monkeypatch.setattr("bridge.adapters.ros2.types.is_compiled", lambda: False)
    with pytest.raises(MessageTypeError, match="not compiled"):
        types.prepare_services()


def test_a_service_class_for_cyclone_dds_has_the_supports_of_both_messages() -> None:
    parts = f"RIHS01_{'1' * 64}", f"RIHS01_{'2' * 64}"
    raw = dds("rmw_cyclonedds_cpp").types.service_class("std_srvs/srv/SetBool", f"RIHS01_{'3' * 64}", parts)
    assert raw.type_name == "std_srvs/srv/SetBool"
    assert raw.request_support not in (0, raw.response_support)
