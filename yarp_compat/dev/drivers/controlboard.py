"""A control board as a device (`controlBoard_nwc_yarp_params.md` of YARP 4, `RemoteControlBoard_params.md` of 3.12)."""

from __future__ import annotations

from yarp_compat.dev.controlboard.client import STATE, ControlBoardClient
from yarp_compat.dev.controlboard.views import VIEWS
from yarp_compat.dev.drivers.registry import DeviceOptions, OpenDevice


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
