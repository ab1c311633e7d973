"""Which form of requests servers need, and when they cannot be called, by the vendor in their GIDs."""

from __future__ import annotations

import pytest

from bridge.adapters.ros2.graph import vendors
from bridge.hub.wire.qos import Qos
from bridge.routing.edge import Endpoint, Kind, MadeBy

CYCLONE, FAST, OTHERS = "0110", "010f", ("0101", "0103", "0000", "4453")
BOTH = (CYCLONE, FAST)
ACTION = "nav2_msgs/action/NavigateToPose"


def endpoint(vendor: str, kind: Kind = Kind.SERVER, made_by: MadeBy = MadeBy.NATIVE, **more: str) -> Endpoint:
    described = {"topic": "/lamp", "type": "std_srvs/srv/SetBool", "node": f"/of_{vendor}", **more}
    return Endpoint(f"{vendor:0<32}", kind, qos=Qos(), made_by=made_by, **described)


def test_servers_on_cyclone_dds_can_be_called_in_their_own_form() -> None:
    servers = [endpoint(CYCLONE), endpoint(CYCLONE)]
    assert vendors.called(servers) == servers
    assert vendors.notes(servers) == {}
    assert vendors.of_servers("/lamp", servers) is None
    assert vendors.are_cyclone(servers)


def test_servers_on_two_kinds_of_dds_cannot_be_called_without_a_filter() -> None:
    servers = [endpoint(FAST), endpoint(CYCLONE)]
    obstacle = vendors.of_servers("/lamp", servers)
    assert obstacle is not None
    assert "/lamp is served on Cyclone DDS (/of_0110) and on another DDS (/of_010f): " in obstacle.reason
    assert "stop one of them" in obstacle.cure
    assert not vendors.are_cyclone(servers)
    assert vendors.called(servers) == servers[:1]
    assert vendors.notes(servers) == {"/lamp": ["calls go to /of_010f, and not to /of_0110 on Cyclone DDS"]}


@pytest.mark.parametrize("vendor", [FAST, *OTHERS])
def test_servers_of_other_vendors_are_called_like_those_on_fast_dds(vendor: str) -> None:
    assert vendors.of_servers("/lamp", [endpoint(vendor)]) is None
    assert not vendors.are_cyclone([endpoint(vendor)])
    assert not vendors.is_cyclone(bytes.fromhex(endpoint(vendor).id))


@pytest.mark.parametrize("vendor", [FAST, CYCLONE])
def test_servers_of_another_midspan_do_not_count(vendor: str) -> None:
    """A Midspan server drops requests from other Midspan daemons."""
    own = endpoint(FAST, made_by=MadeBy.MIDSPAN)
    servers = [endpoint(vendor), own]
    assert vendors.of_servers("/lamp", servers) is None
    assert vendors.are_cyclone(servers) is (vendor == CYCLONE)


def test_without_a_server_there_is_no_vendor() -> None:
    assert not vendors.are_cyclone([])
    assert vendors.of_servers("/lamp", []) is None


def test_report_names_nodes_and_what_is_served_twice() -> None:
    result = vendors.report(
        [
            endpoint(CYCLONE),
            endpoint(FAST),
            *(endpoint(vendor, topic="/n/get_parameters", type="rcl_interfaces/srv/GetParameters") for vendor in BOTH),
            *(endpoint(vendor, topic="/go/_action/send_goal", type=f"{ACTION}_SendGoal") for vendor in BOTH),
            *(endpoint(vendor, topic="/go/_action/get_result", type=f"{ACTION}_GetResult") for vendor in BOTH),
            endpoint(CYCLONE, Kind.PUBLISHER, topic="/scan", type="sensor_msgs/msg/LaserScan", node=""),
            endpoint(CYCLONE, topic="/fine"),
        ]
    )
    assert result == {"nodes": ["/of_0110", "a node with an unknown name"], "both": ["/go", "/lamp"], "mixed": []}
    assert (
        "/go, /lamp: served on Cyclone DDS and on another DDS, so the servers on Cyclone DDS are not called"
        in vendors.warning(result)
    )
    only_nodes = vendors.report([endpoint(CYCLONE)])
    assert only_nodes == {"nodes": ["/of_0110"], "both": [], "mixed": []}
    assert vendors.warning(only_nodes) == ""
    assert vendors.report([endpoint(FAST)]) == {}


def test_native_clients_and_servers_of_two_kinds_are_reported() -> None:
    """ROS 2 itself delivers such requests, in the wrong form."""
    send_goal = {"topic": "/go/_action/send_goal", "type": f"{ACTION}_SendGoal"}
    get_result = {"topic": "/go/_action/get_result", "type": f"{ACTION}_GetResult"}
    ends = [
        endpoint(FAST, Kind.CLIENT, node="/remote"),
        endpoint(CYCLONE, node="/lamp"),
        *(endpoint(CYCLONE, Kind.CLIENT, node="/panel", **part) for part in (send_goal, get_result)),
        *(endpoint(FAST, node="/nav", **part) for part in (send_goal, get_result)),
        endpoint(CYCLONE, Kind.CLIENT, topic="/fine"),
        endpoint(CYCLONE, topic="/fine"),
        endpoint(FAST, Kind.CLIENT, MadeBy.MIDSPAN, topic="/fine"),
    ]
    lamp, go = "client /remote, server /lamp on Cyclone DDS", "client /panel on Cyclone DDS, server /nav"
    assert vendors.report(ends)["mixed"] == [f"/go ({go})", f"/lamp ({lamp})"]
    assert set(vendors.notes(ends)) == {"/lamp", "/go/_action/send_goal", "/go/_action/get_result"}
    assert vendors.notes(ends)["/lamp"][0].startswith(f"{lamp}: between two kinds of DDS, ROS 2 executes")
    (text,) = vendors.warnings_on_cyclone(ends, ())[:1]
    assert text == vendors.mixed_warning(vendors.report(ends)["mixed"])
    assert text.endswith("; run both on the same RMW_IMPLEMENTATION, or in two domains, each with a Midspan daemon")
    both = [*ends, endpoint(FAST, node="/other_lamp")]
    assert len(vendors.notes(both)["/lamp"]) == 2, "the native server on Cyclone DDS still executes it wrongly"
