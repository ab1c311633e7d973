"""Clients of planner, map server, localization server and base as devices with YARP's options.

Ports and options are the same from YARP 3.6 to 4.0 (``*_nwc_yarp_params.md`` of 4.0 lists the options). The names of
devices before 3.7, such as ``navigation2DClient``, are also known (`yarp_compat.dev.drivers.registry`).
"""

from __future__ import annotations

from yarp_compat.dev.basecontrol import MobileBaseVelocityControl
from yarp_compat.dev.drivers.registry import DeviceOptions, OpenDevice
from yarp_compat.dev.localization2d import Localization2DClient
from yarp_compat.dev.map2d_client import Map2DClient
from yarp_compat.dev.navigation2d_client import Navigation2DClient


def navigation2d(options: DeviceOptions) -> OpenDevice:
    """Open with port prefixes: ``local``, ``navigation_server``, ``map_locations_server``, ``localization_server``."""
    client = Navigation2DClient(
        options.port("navigation_server"),
        options.port("map_locations_server"),
        options.port("localization_server"),
        options.port("local"),
        naming=options.naming,
    ).open()
    return OpenDevice(client.close, {"INavigation2D": client, "IMap2D": client, "ILocalization2D": client})


def localization2d(options: DeviceOptions) -> OpenDevice:
    """Open with the port prefixes ``local`` and ``remote``."""
    client = Localization2DClient(options.port("remote"), options.port("local"), naming=options.naming).open()
    return OpenDevice(client.close, {"ILocalization2D": client})


def map2d(options: DeviceOptions) -> OpenDevice:
    """Open with the port prefixes ``local`` and ``remote``, and the ``carrier`` of the calls."""
    server = f"{options.text('carrier', 'fast_tcp')}:/{options.port('remote')}/rpc"
    client = Map2DClient(server, f"{options.port('local')}/mapClient_rpc", naming=options.naming).open()
    return OpenDevice(client.close, {"IMap2D": client})


def mobile_base_velocity_control(options: DeviceOptions) -> OpenDevice:
    """Open with the port prefixes ``local`` and ``server``, and the ``carrier`` of the commands."""
    server = f"{options.text('carrier', 'tcp')}:/{options.port('server')}/rpc:i"
    name = f"{options.port('local')}/navigation/rpc:o"
    client = MobileBaseVelocityControl(server, name, naming=options.naming).open()
    return OpenDevice(client.close, {"INavigation2DVelocityActions": client})
