"""The clients of a robot's parts as devices, with the options of YARP's own: boards, laser, odometry, battery, camera.

And of a language model. The options of a board: `controlBoard_nwc_yarp_params.md` of YARP 4,
`RemoteControlBoard_params.md` of 3.12.
"""

from __future__ import annotations

from yarp_compat.dev.basecontrol import Odometry2DClient
from yarp_compat.dev.battery import BatteryClient
from yarp_compat.dev.controlboard.client import STATE, ControlBoardClient
from yarp_compat.dev.controlboard.views import VIEWS
from yarp_compat.dev.drivers.registry import DeviceError, DeviceOptions, OpenDevice
from yarp_compat.dev.framegrabber import FrameGrabberClient
from yarp_compat.dev.llm import LLMClient
from yarp_compat.dev.rangefinder_client import Rangefinder2DClient


def controlboard(options: DeviceOptions) -> OpenDevice:
    """``remote`` and ``local``: what ports begin with; ``carrier`` of the streams, ``timeout`` of the state, seconds.

    ``writeStrict`` ``on``: no streamed command takes the place of one that is still on its way.
    """
    client = ControlBoardClient(
        options.port("remote"),
        options.port("local"),
        naming=options.naming,
        carrier=options.text("carrier", "fast_tcp"),
        timeout=options.number("timeout", STATE),
        strict=options.flag("writeStrict", default=False),
    ).open()
    return OpenDevice(client.close, {view.__name__: view(client) for view in VIEWS})


def rangefinder2d(options: DeviceOptions) -> OpenDevice:
    """``local`` and ``remote``: the ports of the stream, which begin the others' names; ``carrier`` of the stream."""
    client = Rangefinder2DClient(
        options.port("remote"), options.port("local"), options.text("carrier", "tcp"), naming=options.naming
    ).open()
    outcome, first, last = client.getScanLimits()
    if not outcome or last < first:
        client.close()
        raise DeviceError(f"the laser {client.server} does not say in which directions it measures")
    return OpenDevice(client.close, {"IRangefinder2D": client})


def odometry2d(options: DeviceOptions) -> OpenDevice:
    """``local`` and ``remote``: what the ports' names begin with; ``carrier`` of the stream."""
    client = Odometry2DClient(
        options.port("remote"), options.port("local"), options.text("carrier", "tcp"), naming=options.naming
    ).open()
    return OpenDevice(client.close, {"IOdometry2D": client})


def battery(options: DeviceOptions) -> OpenDevice:
    """``local`` and ``remote``: what the ports' names begin with; ``carrier`` of the stream."""
    client = BatteryClient(
        options.port("remote"), options.port("local"), options.text("carrier", "fast_tcp"), naming=options.naming
    ).open()
    return OpenDevice(client.close, {"IBattery": client})


def frame_grabber(options: DeviceOptions) -> OpenDevice:
    """``local`` and ``remote``: the ports of the images, which begin the others' names; ``carrier``; ``no_stream``.

    What ``remote_grabber`` connected to answered by the port of the images itself, and some still do.
    """
    remote, carrier = options.port("remote"), options.text("carrier", "fast_tcp")
    answers = f"{remote}/rpc"
    if options.device == "remote_grabber":
        carrier = options.text("stream", carrier)
        answers = answers if options.naming.query(answers) is not None else remote
    stream = not options.flag("no_stream", default=False)
    client = FrameGrabberClient(
        remote, options.port("local"), carrier, answers, stream=stream, naming=options.naming
    ).open()
    views = {"IFrameGrabberControls": client}
    return OpenDevice(client.close, views | ({"IFrameGrabberImage": client} if stream else {}))


def llm(options: DeviceOptions) -> OpenDevice:
    """``local`` and ``remote``: the names of both ports."""
    client = LLMClient(options.port("remote"), options.port("local"), naming=options.naming).open()
    return OpenDevice(client.close, {"ILLM": client.llm})
