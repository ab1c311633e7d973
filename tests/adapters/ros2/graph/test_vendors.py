"""Which endpoints prevent calls from crossing, by the vendor in their GIDs."""

from __future__ import annotations

import pytest

from bridge.adapters.ros2.graph import vendors
from bridge.hub.wire.qos import Qos
from bridge.routing.edge import Endpoint, Kind, MadeBy

CYCLONE, FAST, OTHERS = "0110", "010f", ("0101", "0103", "0000", "4453")


def endpoint(vendor: str, kind: Kind = Kind.SERVER, made_by: MadeBy = MadeBy.NATIVE, **more: str) -> Endpoint:
    described = {"topic": "/lamp", "type": "std_srvs/srv/SetBool", "node": f"/of_{vendor}", **more}
    return Endpoint(f"{vendor:0<32}", kind, qos=Qos(), made_by=made_by, **described)


def test_server_on_cyclone_dds_is_not_called() -> None:
    obstacle = vendors.of_servers("/lamp", [endpoint(CYCLONE)])
    assert obstacle is not None
    assert "/lamp is served on Cyclone DDS (/of_0110): " in obstacle.reason
    assert "RMW_IMPLEMENTATION=rmw_fastrtps_cpp" in obstacle.cure


def test_one_of_several_servers_on_cyclone_dds_suffices() -> None:
    obstacle = vendors.of_servers("/lamp", [endpoint(FAST), endpoint(CYCLONE)])
    assert obstacle is not None
    assert "(/of_0110) too, and DDS delivers each request to all servers" in obstacle.reason


@pytest.mark.parametrize("vendor", [FAST, *OTHERS])
def test_servers_and_clients_of_other_vendors_are_no_obstacle(vendor: str) -> None:
    assert vendors.of_servers("/lamp", [endpoint(vendor)]) is None
    assert vendors.of_clients("/lamp", [endpoint(vendor, Kind.CLIENT)]) is None
    assert not vendors.is_cyclone(bytes.fromhex(endpoint(vendor).id))


def test_server_of_a_midspan_is_no_obstacle() -> None:
    assert vendors.of_servers("/lamp", [endpoint(CYCLONE, made_by=MadeBy.MIDSPAN)]) is None


def test_clients_on_cyclone_dds_are_named() -> None:
    clients = [endpoint(vendor, Kind.CLIENT) for vendor in (FAST, CYCLONE)]
    obstacle = vendors.of_clients("/lamp", clients)
    assert obstacle is not None
    assert "from Cyclone DDS (/of_0110) are refused" in obstacle.reason


def test_report_omits_services_that_every_node_has() -> None:
    result = vendors.report(
        [
            endpoint(CYCLONE),
            endpoint(CYCLONE, topic="/n/get_parameters", type="rcl_interfaces/srv/GetParameters"),
            endpoint(CYCLONE, topic="/go/_action/send_goal", type="nav2_msgs/action/NavigateToPose_SendGoal"),
            endpoint(CYCLONE, topic="/go/_action/get_result", type="nav2_msgs/action/NavigateToPose_GetResult"),
            endpoint(CYCLONE, Kind.PUBLISHER, topic="/scan", type="sensor_msgs/msg/LaserScan", node=""),
            endpoint(FAST, topic="/fine"),
        ]
    )
    assert result == {"nodes": ["/of_0110", "a node with an unknown name"], "served": ["/go", "/lamp"], "called": []}
    assert "(/go, /lamp) cannot be called" in vendors.warning(result)
    assert vendors.report([endpoint(FAST)]) == {}
