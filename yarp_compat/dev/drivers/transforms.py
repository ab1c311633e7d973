"""The clients of a server of transforms as devices.

``frameTransformClient`` is made of others by a file that ``config_name`` (``filexml_option`` before 4.0) names; those
that come with YARP are known here by their names. ``transformClient``, which was there before 3.9, spoke to a
``transformServer`` with words of its own: here it is a client of today's servers.
"""

from __future__ import annotations

import logging

from yarp_compat.dev.drivers.registry import DeviceError, DeviceOptions, OpenDevice
from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.frametransform_client import LIFETIME, TransformClient
from yarp_compat.dev.frametransform_local import LocalTransforms
from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue

log = logging.getLogger("yarp.dev.PolyDriver")

_LOCAL = "ftc_local_only.xml"
_LISTENING = "ftc_sub_yarp_only.xml"
_BOTH = ("ftc_yarp_only.xml", "ftc_pub_yarp_only.xml")
_REFUSED = ReturnValue(ReturnCode.NOT_IMPLEMENTED)


class _Listener(TransformClient):
    """Sets and deletes nothing, as ``ftc_sub_yarp_only.xml``."""

    def send(self, transforms: list[FrameTransform]) -> ReturnValue:  # noqa: ARG002
        return _REFUSED

    def forget(self, one: str, other: str) -> ReturnValue:  # noqa: ARG002
        return _REFUSED

    def forget_all(self) -> ReturnValue:
        return _REFUSED


def frame_transform_client(options: DeviceOptions) -> OpenDevice:
    """What ``config_name`` says: by default transforms of this program alone; see `frame_transform` for the rest.

    ``ftc_storage_timeout``: seconds after which they expire.
    """
    for key in ("custom_config_from", "testxml_from", "testxml_option"):
        if options.has(key):
            raise DeviceError(f"{key}: a file of devices cannot be read here; say config_name {_BOTH[0]}")
    asked = options.text("config_name", options.text("filexml_option", _LOCAL))
    if asked == _LOCAL:
        kept = LocalTransforms(options.number("ftc_storage_timeout", LIFETIME))
        return OpenDevice(kept.forget_all, {"IFrameTransform": kept})
    if asked == _LISTENING:
        return _opened(_Listener, options)
    if asked in _BOTH:
        return frame_transform(options)
    raise DeviceError(f"config_name {asked} is not known here; there are {', '.join((_LOCAL, *_BOTH, _LISTENING))}")


def frame_transform(options: DeviceOptions) -> OpenDevice:
    """A client of a server: ``ft_server_prefix`` begins the names of its ports, ``ft_client_prefix`` the own ones.

    Without the latter the name server chooses the own ports' names. ``ftGet_client_enable_stream``: hear the server's
    stream, instead of asking for each question.
    """
    return _opened(TransformClient, options)


def transform_client(options: DeviceOptions) -> OpenDevice:
    """``local`` begins the own ports' names; ``remote`` is looked at by nobody, see the module."""
    local = options.port("local")
    log.warning(
        "transformClient: %s is not asked, but the ports of /frameTransformServer, which came after it",
        options.port("remote"),
    )
    client = TransformClient("", local, naming=options.naming).open()
    return OpenDevice(client.close, {"IFrameTransform": client})


def _opened(kind: type[TransformClient], options: DeviceOptions) -> OpenDevice:
    server, own = (options.text(key, "") and options.port(key) for key in ("ft_server_prefix", "ft_client_prefix"))
    streaming = options.flag("ftGet_client_enable_stream", default=True)
    client = kind(server, own, streaming=streaming, naming=options.naming).open()
    return OpenDevice(client.close, {"IFrameTransform": client})
