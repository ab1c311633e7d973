"""A camera: its images, and its controls (`frameGrabberMsgs.thrift`, `IFrameGrabberControls.h`).

Ports (`frameGrabber_nws_yarp`): the stream of images ``<name>``, and ``<name>/rpc``. Servers before 4.0 use vocabs: the
reply to ``[fgc] [get] [feat] 16`` is ``[fgc] [feat] [is] 0.5``; the reply to ``[fgc] [has] [feat] 16`` is ``[fgc] [has]
[feat]``, a number, and 1.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - the names are those of YARP's .thrift file

from __future__ import annotations

from collections.abc import MutableSequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self, Unpack

from yarp_compat.dev.client import ClientOptions, ServiceClient, StreamReader
from yarp_compat.dev.fields import Structure
from yarp_compat.dev.returnvalue import OK, UNREACHED, ReturnCode, ReturnValue, fill, results_of
from yarp_compat.dev.service import Service, rpc
from yarp_compat.overriding import override
from yarp_compat.ports.sockets import closed_on_failure
from yarp_compat.pythonic import payload_of
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.values import Vocab


class BusType(IntEnum):
    """The bus of a camera."""

    BUS_UNKNOWN = 0
    BUS_FIREWIRE = 1
    BUS_USB = 2


class FeatureMode(IntEnum):
    """How a feature of a camera is set: manually, or by the camera."""

    MODE_UNKNOWN = 0
    MODE_MANUAL = 1
    MODE_AUTO = 2


CameraFeature = IntEnum(
    "CameraFeature",
    "YARP_FEATURE_INVALID YARP_FEATURE_BRIGHTNESS YARP_FEATURE_EXPOSURE YARP_FEATURE_SHARPNESS "
    "YARP_FEATURE_WHITE_BALANCE YARP_FEATURE_HUE YARP_FEATURE_SATURATION YARP_FEATURE_GAMMA YARP_FEATURE_SHUTTER "
    "YARP_FEATURE_GAIN YARP_FEATURE_IRIS YARP_FEATURE_FOCUS YARP_FEATURE_TEMPERATURE YARP_FEATURE_TRIGGER "
    "YARP_FEATURE_TRIGGER_DELAY YARP_FEATURE_WHITE_SHADING YARP_FEATURE_FRAME_RATE YARP_FEATURE_ZOOM YARP_FEATURE_PAN "
    "YARP_FEATURE_TILT YARP_FEATURE_OPTICAL_FILTER YARP_FEATURE_CAPTURE_SIZE YARP_FEATURE_CAPTURE_QUALITY "
    "YARP_FEATURE_MIRROR YARP_FEATURE_NUMBER_OF",
    start=-1,
)
"""The features of a camera (``cameraFeature_id_t``)."""


@dataclass
class CameraDescriptor(Structure):
    """A camera's bus and name."""

    busType: BusType = BusType.BUS_UNKNOWN
    deviceDescription: str = ""


@rpc
class FrameGrabberMsgs(Service):
    """The methods of a camera's port for its controls."""

    def getCameraDescriptionRPC(self) -> tuple[ReturnValue, CameraDescriptor]: ...
    def hasFeatureRPC(self, feature: int) -> tuple[ReturnValue, bool]: ...
    def setFeature1RPC(self, feature: int, value: float) -> ReturnValue: ...
    def getFeature1RPC(self, feature: int) -> tuple[ReturnValue, float]: ...
    def setFeature2RPC(self, feature: int, value1: float, value2: float) -> ReturnValue: ...
    def getFeature2RPC(self, feature: int) -> tuple[ReturnValue, float, float]: ...
    def hasOnOffRPC(self, feature: int) -> tuple[ReturnValue, bool]: ...
    def setActiveRPC(self, feature: int, onoff: bool) -> ReturnValue: ...
    def getActiveRPC(self, feature: int) -> tuple[ReturnValue, bool]: ...
    def hasAutoRPC(self, feature: int) -> tuple[ReturnValue, bool]: ...
    def hasManualRPC(self, feature: int) -> tuple[ReturnValue, bool]: ...
    def hasOnePushRPC(self, feature: int) -> tuple[ReturnValue, bool]: ...
    def setModeRPC(self, feature: int, mode: FeatureMode) -> ReturnValue: ...
    def getModeRPC(self, feature: int) -> tuple[ReturnValue, FeatureMode]: ...
    def setOnePushRPC(self, feature: int) -> ReturnValue: ...


class IFrameGrabberControls:
    """A camera's controls under YARP's names; a value that is not reported is 0, False or ``MODE_UNKNOWN``."""

    def request(self, method: str, vocabs: tuple[str, str], *arguments: float) -> tuple[Any, ...]:
        """Call a method of 4.0, or in older servers an action and its object (vocabs); return outcome and results."""
        raise NotImplementedError

    def getCameraDescription(self, camera: CameraDescriptor) -> ReturnValue:
        """Fill in the camera's bus and name."""
        outcome, *results = self.request("getCameraDescriptionRPC", ("get", "camd"))
        if outcome:
            separate = len(results) > 1  # before 4.0, instead of one structure
            fill(camera, CameraDescriptor(BusType(int(results[0])), str(results[1])) if separate else results[0])
        return ReturnValue(outcome.code)

    def busType2String(self, type: BusType) -> str:  # noqa: A002 - YARP's name
        """Return the name of a bus."""
        return {BusType.BUS_FIREWIRE: "FireWire", BusType.BUS_USB: "USB"}.get(type, "bus type undefined")

    def toFeatureMode(self, _auto: bool) -> FeatureMode:
        """Return ``MODE_AUTO`` for True, ``MODE_MANUAL`` for False."""
        return FeatureMode.MODE_AUTO if _auto else FeatureMode.MODE_MANUAL

    def hasFeature(self, feature: int) -> bool:
        """Whether the camera has a feature."""
        return self._ask_bool("hasFeatureRPC", ("has", "feat"), feature)

    def hasOnOff(self, feature: int) -> bool:
        """Whether a feature can be switched off."""
        return self._ask_bool("hasOnOffRPC", ("has", "onof"), feature)

    def hasAuto(self, feature: int) -> bool:
        """Whether the camera can set a feature automatically."""
        return self._ask_bool("hasAutoRPC", ("has", "auto"), feature)

    def hasManual(self, feature: int) -> bool:
        """Whether a feature can be set manually."""
        return self._ask_bool("hasManualRPC", ("has", "man"), feature)

    def hasOnePush(self, feature: int) -> bool:
        """Whether the camera can set a feature once, on request."""
        return self._ask_bool("hasOnePushRPC", ("has", "onep"), feature)

    def getActive(self, feature: int) -> bool:
        """Whether a feature is switched on."""
        return self._ask_bool("getActiveRPC", ("get", "actv"), feature)

    def setActive(self, feature: int, onoff: bool) -> ReturnValue:
        """Switch a feature on or off."""
        return self._command("setActiveRPC", ("set", "actv"), feature, onoff)

    def getFeature(
        self, feature: int, value1: MutableSequence[float] | None = None, value2: MutableSequence[float] | None = None
    ) -> Any:
        """Return a feature's value; with two lists, store its two values in them and return whether that succeeded."""
        if value1 is None or value2 is None:
            outcome, *results = self.request("getFeature1RPC", ("get", "feat"), feature)
            return float(results[0]) if outcome else 0.0
        outcome, *results = self.request("getFeature2RPC", ("get", "fea2"), feature)
        if outcome:
            value1[:1], value2[:1] = [float(results[0])], [float(results[1])]
        return bool(outcome)

    def setFeature(self, feature: int, value: float, value2: float | None = None) -> ReturnValue:
        """Set a feature's value, or its two values."""
        if value2 is None:
            return self._command("setFeature1RPC", ("set", "feat"), feature, float(value))
        return self._command("setFeature2RPC", ("set", "fea2"), feature, float(value), float(value2))

    def getMode(self, feature: int) -> FeatureMode:
        """Return how a feature is set."""
        outcome, *results = self.request("getModeRPC", ("get", "mode"), feature)
        return FeatureMode(int(results[0])) if outcome else FeatureMode.MODE_UNKNOWN

    def setMode(self, feature: int, mode: FeatureMode) -> ReturnValue:
        """Select how a feature is set."""
        return self._command("setModeRPC", ("set", "mode"), feature, FeatureMode(mode))

    def setOnePush(self, feature: int) -> ReturnValue:
        """Let the camera set a feature once."""
        return self._command("setOnePushRPC", ("set", "onep"), feature)

    def _ask_bool(self, method: str, vocabs: tuple[str, str], feature: int) -> bool:
        outcome, *results = self.request(method, vocabs, int(feature))
        return bool(outcome and results[0])

    def _command(self, method: str, vocabs: tuple[str, str], feature: int, *values: float) -> ReturnValue:
        return ReturnValue(self.request(method, vocabs, int(feature), *values)[0].code)


class FrameGrabberClient(ServiceClient[FrameGrabberMsgs], IFrameGrabberControls):
    """A client that receives a camera's images and sets its controls, like YARP's ``frameGrabber_nwc_yarp``.

    ``server`` is the server's port for images, ``rpc_port`` its port for controls (by default ``<server>/rpc``);
    ``name`` is the client's port for images, ``<name>/rpc_client`` its port for calls; ``carrier`` is for images. For
    the options, see `ServiceClient`.
    """

    def __init__(
        self, server: str, name: str = "", carrier: str = "", rpc_port: str = "", *, stream: bool = True,
        **options: Unpack[ClientOptions],
    ) -> None:  # fmt: skip
        own_rpc_port = name and f"{name}/rpc_client"
        super().__init__(FrameGrabberMsgs, rpc_port or f"{server}/rpc", own_rpc_port, **options)
        self._reader = StreamReader(server, name, carrier, naming=options.get("naming")) if stream else None
        self._size = (0, 0)

    @override
    def open(self) -> Self:
        super().open()
        with closed_on_failure(self):
            if self._reader is not None:
                self._reader.open()
        return self

    @override
    def close(self) -> None:
        """Close the ports, which ends pending `getImage` calls."""
        if self._reader is not None:
            self._reader.close()
        super().close()

    def getImage(self, image: Any) -> ReturnValue:
        """Wait for the next image and copy it into ``image``; fails after `close`, or without a stream."""
        received = None if self._reader is None else self._reader.read()
        if received is None:
            return UNREACHED
        try:
            decoded = received.to(type(image))
        except WireError:
            return ReturnValue(ReturnCode.METHOD_FAILED)
        self._size = (decoded.width(), decoded.height())
        fill(image, decoded)
        return OK

    def width(self) -> int:
        """Return the number of columns of the last image; 0 before the first image."""
        return self._size[0]

    def height(self) -> int:
        """Return the number of rows of the last image; 0 before the first image."""
        return self._size[1]

    @override
    def request(self, method: str, vocabs: tuple[str, str], *arguments: float) -> tuple[Any, ...]:
        """Call a method; servers before 4.0 are sent vocabs."""
        if self.version is not None:
            return results_of(getattr(self.remote, method), *arguments)
        action, subject = vocabs
        plain = [float(value) if isinstance(value, float) else int(value) for value in arguments]
        try:
            request = payload_of([Vocab("fgc"), Vocab(action), Vocab(subject), *plain])
            answer = binary.decode(self._channel.request(request, None))
        except (OSError, WireError):
            return (UNREACHED,)
        first = 4 if action == "has" else 3  # [fgc] [has] [feat] number value; [fgc] [feat] [is] value
        if answer[:1] == ["fail"] or (action != "set" and len(answer) <= first):
            return (ReturnValue(ReturnCode.METHOD_FAILED),)
        return (OK, *(answer[first:] if action != "set" else ()))
