"""Clients of a robot's parts as devices with YARP's options: boards, laser, odometry, battery, camera.

This module also has the client of a language model. The options of a board are those in
`controlBoard_nwc_yarp_params.md` of YARP 4 and `RemoteControlBoard_params.md` of 3.12.
"""

from __future__ import annotations

from yarp_compat.dev.basecontrol import Odometry2DClient
from yarp_compat.dev.battery import BatteryClient
from yarp_compat.dev.controlboard.client import STATE_TIMEOUT, ControlBoardClient
from yarp_compat.dev.controlboard.views import VIEWS
from yarp_compat.dev.drivers.registry import DeviceError, DeviceOptions, OpenDevice
from yarp_compat.dev.framegrabber import FrameGrabberClient
from yarp_compat.dev.llm import LLMClient
from yarp_compat.dev.rangefinder_client import Rangefinder2DClient


def controlboard(options: DeviceOptions) -> OpenDevice:
    """Open with the port prefixes ``remote`` and ``local``, the streams' ``carrier``, and ``timeout``.

    A state of the joints is valid for ``timeout`` seconds.
    With ``writeStrict`` ``on``, no streamed command replaces one that is still queued.
    """
    client = ControlBoardClient(
        options.port("remote"),
        options.port("local"),
        naming=options.naming,
        carrier=options.text("carrier", "fast_tcp"),
        timeout=options.number("timeout", STATE_TIMEOUT),
        strict=options.flag("writeStrict", default=False),
    ).open()
    return OpenDevice(client.close, {view.__name__: view(client) for view in VIEWS})


def rangefinder2d(options: DeviceOptions) -> OpenDevice:
    """Open with ``local`` and ``remote``, the stream's ports, and its ``carrier``; the RPC ports extend their names."""
    client = Rangefinder2DClient(
        options.port("remote"), options.port("local"), options.text("carrier", "tcp"), naming=options.naming
    ).open()
    outcome, first, last = client.getScanLimits()
    if not outcome or last < first:
        client.close()
        raise DeviceError(f"the laser {client.server} does not report its scan limits")
    return OpenDevice(client.close, {"IRangefinder2D": client})


def odometry2d(options: DeviceOptions) -> OpenDevice:
    """Open with the port prefixes ``local`` and ``remote``, and the stream's ``carrier``."""
    client = Odometry2DClient(
        options.port("remote"), options.port("local"), options.text("carrier", "tcp"), naming=options.naming
    ).open()
    return OpenDevice(client.close, {"IOdometry2D": client})


def battery(options: DeviceOptions) -> OpenDevice:
    """Open with the port prefixes ``local`` and ``remote``, and the stream's ``carrier``."""
    client = BatteryClient(
        options.port("remote"), options.port("local"), options.text("carrier", "fast_tcp"), naming=options.naming
    ).open()
    return OpenDevice(client.close, {"IBattery": client})


def frame_grabber(options: DeviceOptions) -> OpenDevice:
    """Open with ``local`` and ``remote``, the images' ports, ``carrier`` and ``no_stream``.

    The RPC ports are ``<remote>/rpc`` and ``<local>/rpc_client``. Servers for ``remote_grabber`` used to reply at the
    images' port itself, and some still do.
    """
    remote, carrier = options.port("remote"), options.text("carrier", "fast_tcp")
    rpc_port = f"{remote}/rpc"
    if options.device == "remote_grabber":
        carrier = options.text("stream", carrier)
        rpc_port = rpc_port if options.naming.query(rpc_port) is not None else remote
    stream = not options.flag("no_stream", default=False)
    client = FrameGrabberClient(
        remote, options.port("local"), carrier, rpc_port, stream=stream, naming=options.naming
    ).open()
    views = {"IFrameGrabberControls": client}
    return OpenDevice(client.close, views | ({"IFrameGrabberImage": client} if stream else {}))


def llm(options: DeviceOptions) -> OpenDevice:
    """Open with ``local`` and ``remote``, the names of both ports."""
    client = LLMClient(options.port("remote"), options.port("local"), naming=options.naming).open()
    return OpenDevice(client.close, {"ILLM": client.llm})
