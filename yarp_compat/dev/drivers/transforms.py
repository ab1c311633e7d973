"""Clients of a transform server as devices.

``frameTransformClient`` combines other devices as described in the file ``config_name`` (``filexml_option`` before
4.0); the files that come with YARP are recognized by their names. ``transformClient`` of releases before 3.9 used a
different protocol with a ``transformServer``: here it is a client of current servers.
"""

from __future__ import annotations

import logging

from yarp_compat.dev.drivers.registry import DeviceError, DeviceOptions, OpenDevice
from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.frametransform_client import LIFETIME, TransformClient
from yarp_compat.dev.frametransform_local import LocalTransforms
from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue
from yarp_compat.overriding import override

log = logging.getLogger("yarp.dev.PolyDriver")

_LOCAL = "ftc_local_only.xml"
_LISTENING = "ftc_sub_yarp_only.xml"
_BOTH = ("ftc_yarp_only.xml", "ftc_pub_yarp_only.xml")
_REFUSED = ReturnValue(ReturnCode.NOT_IMPLEMENTED)


class _ReadOnlyClient(TransformClient):
    """A client that cannot set or delete transforms, as with ``ftc_sub_yarp_only.xml``."""

    @override
    def send(self, transforms: list[FrameTransform]) -> ReturnValue:
        return _REFUSED

    @override
    def remove(self, first: str, second: str) -> ReturnValue:
        return _REFUSED

    @override
    def remove_all(self) -> ReturnValue:
        return _REFUSED


def frame_transform_client(options: DeviceOptions) -> OpenDevice:
    """Open what ``config_name`` selects: a store inside this program (the default), or a client of a server.

    The client has the options of `frame_transform`. ``ftc_storage_timeout``: seconds after which this program's own
    transforms expire.
    """
    for key in ("custom_config_from", "testxml_from", "testxml_option"):
        if options.has(key):
            raise DeviceError(f"{key}: files of devices are not supported; set config_name to {_BOTH[0]}")
    config = options.text("config_name", options.text("filexml_option", _LOCAL))
    if config == _LOCAL:
        local = LocalTransforms(options.number("ftc_storage_timeout", LIFETIME))
        return OpenDevice(local.remove_all, {"IFrameTransform": local})
    if config == _LISTENING:
        return _opened(_ReadOnlyClient, options)
    if config in _BOTH:
        return frame_transform(options)
    raise DeviceError(f"unknown config_name {config}; supported are {', '.join((_LOCAL, *_BOTH, _LISTENING))}")


def frame_transform(options: DeviceOptions) -> OpenDevice:
    """Open a client; ``ft_server_prefix``, ``ft_client_prefix``: the prefixes of the server's and the client's ports.

    Without ``ft_client_prefix``, the name server chooses the names of the client's ports.
    ``ftGet_client_enable_stream``: subscribe to the server's stream instead of sending a request for each query.
    """
    return _opened(TransformClient, options)


def transform_client(options: DeviceOptions) -> OpenDevice:
    """Open with ``local``, the prefix of the client's ports; ``remote`` is required, but ignored, see the module."""
    local = options.port("local")
    log.warning(
        "transformClient: ignoring %s; using its successor, the ports of /frameTransformServer",
        options.port("remote"),
    )
    client = TransformClient("", local, naming=options.naming).open()
    return OpenDevice(client.close, {"IFrameTransform": client})


def _opened(kind: type[TransformClient], options: DeviceOptions) -> OpenDevice:
    server, prefix = (options.text(key, "") and options.port(key) for key in ("ft_server_prefix", "ft_client_prefix"))
    streaming = options.flag("ftGet_client_enable_stream", default=True)
    client = kind(server, prefix, streaming=streaming, naming=options.naming).open()
    return OpenDevice(client.close, {"IFrameTransform": client})
