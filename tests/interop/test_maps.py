"""Real rospy and rclpy programs and a YARP client share maps, through the whole daemon and its Map2DServer."""

from __future__ import annotations

from typing import Any

import numpy as np

from navigation.maps.grid import from_grid
from tests.peers.daemon.deployment import Deployment
from tests.peers.peer import Peer
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.dev.map2d_client import Map2DClient
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.pythonic import Client

GRID = "nav_msgs/OccupancyGrid"


def test_changes_of_one_side_reach_all_others_at_once(deployment: Deployment) -> None:
    number = free_port()
    deployment.start(
        yarp={"address": f"127.0.0.1:{number}", "nameserver": "embedded", "poll": 0.1},
        modules={"map2d_server": {"enabled": True, "take": [{"topic": "/map", "name": "slam", "period": 0.0}]}},
    )
    names = NameClient(Address("127.0.0.1", number), namespace="/root")
    until(lambda: connections.exists(names, "/map2D_server/command"), "the map server's ports are registered", 30)
    with Map2DClient(naming=names, timeout=30) as maps, Client("/map2D_server/command", naming=names) as texts:

        def current() -> str:
            return str(texts.ask(["current"], timeout=30)[0])

        # YARP writes a map: ROS 1 and ROS 2 receive it, with early and with late subscribers
        ros1, ros2 = deployment.ros1(), deployment.ros2()
        on_ros1 = ros1.subscribe("/map", GRID)
        on_ros2, mask = (
            ros2.subscribe(topic, GRID, latched=True, depth=1) for topic in ("/map", "/keepout_filter_mask")
        )
        office = grid("office", wall=3)
        office.flags[0, 5] = MapFlag.KEEP_OUT
        maps.maps["office"] = office
        assert texts.ask(["use", "office"], timeout=30) == ["ok"]
        for peer, subscription in ((ros1, on_ros1), (ros2, on_ros2)):
            until_received(peer, subscription, office)
        until(lambda: 100 in newest(ros2, mask)["data"], "the mask is received", 30, 0.1)
        assert np.argmax(newest(ros2, mask)["data"]) == 11 * 20 + 5
        office.occupancy[5, 5] = 100
        maps.maps["office"] = office
        for peer, subscription in ((ros1, on_ros1), (ros2, on_ros2)):
            until_received(peer, subscription, office)
        assert np.array_equal(
            call(ros1, "/static_map", "nav_msgs/GetMap")["map"]["data"], newest(ros1, on_ros1)["data"]
        )

        # ROS 2 selects another map, then ROS 1 the first one again
        hall = maps.maps["hall"] = grid("hall", wall=7)
        assert call(ros2, "/map_server/load_map", "nav2_msgs/LoadMap", waits=False, map_url="hall")["result"] == 0
        until_received(ros1, on_ros1, hall)
        until_received(ros2, on_ros2, hall)
        assert current() == "hall"
        assert call(ros1, "/change_map", "nav_msgs/LoadMap", map_url="office")["result"] == 0
        until_received(ros2, on_ros2, office)
        assert current() == "office"
        assert call(ros1, "/change_map", "nav_msgs/LoadMap", map_url="../office.yaml")["result"] != 0
        assert current() == "office"

        # a mapper on ROS 1 publishes a map: the store gets it, and nobody else publishes on the mapper's topic
        slam = grid("slam", wall=9)
        mapper = deployment.ros1()
        out = mapper.advertise("/map", GRID, latched=True)
        mapper.publish(out, message(slam))
        until(lambda: "slam" in maps.maps, "the mapper's map is in the store", 30, 0.1)
        assert maps.maps["slam"] == slam
        until_received(ros2, on_ros2, slam)
        until(lambda: current() == "slam", "the mapper's map is the current one", 30, 0.1)
        until(lambda: not deployment.route("ros1", "/map", "out"), "nothing is echoed", 30, 0.1)


def grid(name: str, wall: int) -> MapGrid2D:
    flags = np.zeros((12, 20), np.uint8)
    flags[:, wall] = MapFlag.WALL
    return MapGrid2D.of(flags, name=name, resolution=0.25, origin=(-1.0, -2.0, 0.0))


def message(of: MapGrid2D) -> dict[str, Any]:
    x, y, _ = of.getOrigin()
    info = {"resolution": of.resolution, "width": of.width(), "height": of.height(),
            "origin": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}}  # fmt: skip
    return {"header": {"frame_id": "map"}, "info": info, "data": of.occupancy[::-1].reshape(-1).tolist()}


def newest(peer: Peer, subscription: int) -> dict[str, Any]:
    messages = peer.wait(subscription, 0, 0)
    return messages[-1] if messages else {"data": []}


def until_received(peer: Peer, subscription: int, wanted: MapGrid2D) -> None:
    """Wait until a program's newest received map is this one."""

    def same() -> bool:
        result = newest(peer, subscription)
        return bool(result["data"]) and np.array_equal(from_grid(result, "").occupancy, wanted.occupancy)

    until(same, f"{wanted.name} arrives", 30, 0.1)


def call(peer: Peer, service: str, type_: str, *, waits: bool = True, **request: Any) -> dict[str, Any]:
    """Call a service once it exists, and return the reply. The ROS 2 program waits for the service by itself."""
    if waits:
        peer.ask("await_service", service=service, seconds=30.0)
    call = peer.ask("call", service=service, type=type_, request=request, seconds=30.0)["id"]
    reported = peer.ask("result", id=call, seconds=30.0)
    assert reported["done"], reported
    assert reported["reply"] is not None, reported
    reply: dict[str, Any] = reported["reply"]
    return reply
