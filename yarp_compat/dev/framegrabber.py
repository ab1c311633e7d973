"""A camera: its pictures, and its controls (`frameGrabberMsgs.thrift`, `IFrameGrabberControls.h`).

Ports (`frameGrabber_nws_yarp`): the stream of images ``<name>``, and beside it ``<name>/rpc``. Servers before 4.0
answer words: ``[fgc] [get] [feat] 16`` by ``[fgc] [feat] [is] 0.5``, ``[fgc] [has] [feat] 16`` by four words and a 1.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - names and arguments are those of YARP's .thrift file, and say what each does

from __future__ import annotations

from collections.abc import MutableSequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self, Unpack

from yarp_compat.dev.client import ClientOptions, ServiceClient
from yarp_compat.dev.fields import Structure
from yarp_compat.dev.returnvalue import OK, UNREACHED, ReturnCode, ReturnValue, answered, fill
from yarp_compat.dev.service import Service, rpc
from yarp_compat.naming import connections
from yarp_compat.ports.sockets import closed_on_failure
from yarp_compat.pythonic import Reader
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.values import Vocab


class BusType(IntEnum):
    """How a camera is connected."""

    BUS_UNKNOWN = 0
    BUS_FIREWIRE = 1
    BUS_USB = 2


class FeatureMode(IntEnum):
    """Who sets a feature of a camera: a person, or the camera."""

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
"""What can be set of a camera (``cameraFeature_id_t``)."""


@dataclass
class CameraDescriptor(Structure):
    """A camera's connection and name."""

    busType: BusType = BusType.BUS_UNKNOWN
    deviceDescription: str = ""


@rpc
class FrameGrabberMsgs(Service):
    """The methods of a camera's port that concern its controls."""

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
    """A camera's controls under YARP's names; what the camera does not say is 0, False or ``MODE_UNKNOWN``."""

    def asked(self, method: str, words: tuple[str, str], *arguments: float) -> tuple[Any, ...]:
        """The outcome and results of a method of 4.0, or of an action and its object in older words."""
        raise NotImplementedError

    def getCameraDescription(self, camera: CameraDescriptor) -> ReturnValue:
        """How the camera is connected, and what it is."""
        outcome, *found = self.asked("getCameraDescriptionRPC", ("get", "camd"))
        if outcome:
            fill(camera, found[0] if len(found) == 1 else CameraDescriptor(BusType(int(found[0])), str(found[1])))
        return ReturnValue(outcome.code)

    def busType2String(self, type: BusType) -> str:  # noqa: A002 - YARP's name
        """A kind of connection in words."""
        return {BusType.BUS_FIREWIRE: "FireWire", BusType.BUS_USB: "USB"}.get(type, "bus type undefined")

    def toFeatureMode(self, _auto: bool) -> FeatureMode:
        """Who sets what is set by itself, or not."""
        return FeatureMode.MODE_AUTO if _auto else FeatureMode.MODE_MANUAL

    def hasFeature(self, feature: int) -> bool:
        """Whether the camera has a feature at all."""
        return self._truth("hasFeatureRPC", ("has", "feat"), feature)

    def hasOnOff(self, feature: int) -> bool:
        """Whether it can be switched off."""
        return self._truth("hasOnOffRPC", ("has", "onof"), feature)

    def hasAuto(self, feature: int) -> bool:
        """Whether the camera can set it by itself."""
        return self._truth("hasAutoRPC", ("has", "auto"), feature)

    def hasManual(self, feature: int) -> bool:
        """Whether it can be set."""
        return self._truth("hasManualRPC", ("has", "man"), feature)

    def hasOnePush(self, feature: int) -> bool:
        """Whether the camera can set it once."""
        return self._truth("hasOnePushRPC", ("has", "onep"), feature)

    def getActive(self, feature: int) -> bool:
        """Whether it is switched on."""
        return self._truth("getActiveRPC", ("get", "actv"), feature)

    def setActive(self, feature: int, onoff: bool) -> ReturnValue:
        """Switch it on or off."""
        return self._done("setActiveRPC", ("set", "actv"), feature, onoff)

    def getFeature(
        self, feature: int, value1: MutableSequence[float] | None = None, value2: MutableSequence[float] | None = None
    ) -> Any:
        """Its value; where two lists are given, they get its two values, and whether it has them is returned."""
        if value1 is None or value2 is None:
            outcome, *found = self.asked("getFeature1RPC", ("get", "feat"), feature)
            return float(found[0]) if outcome else 0.0
        outcome, *found = self.asked("getFeature2RPC", ("get", "fea2"), feature)
        if outcome:
            value1[:1], value2[:1] = [float(found[0])], [float(found[1])]
        return bool(outcome)

    def setFeature(self, feature: int, value: float, value2: float | None = None) -> ReturnValue:
        """Set its value, or its two."""
        if value2 is None:
            return self._done("setFeature1RPC", ("set", "feat"), feature, float(value))
        return self._done("setFeature2RPC", ("set", "fea2"), feature, float(value), float(value2))

    def getMode(self, feature: int) -> FeatureMode:
        """Who sets it."""
        outcome, *found = self.asked("getModeRPC", ("get", "mode"), feature)
        return FeatureMode(int(found[0])) if outcome else FeatureMode.MODE_UNKNOWN

    def setMode(self, feature: int, mode: FeatureMode) -> ReturnValue:
        """Say who sets it."""
        return self._done("setModeRPC", ("set", "mode"), feature, FeatureMode(mode))

    def setOnePush(self, feature: int) -> ReturnValue:
        """Have the camera set it once."""
        return self._done("setOnePushRPC", ("set", "onep"), feature)

    def _truth(self, method: str, words: tuple[str, str], feature: int) -> bool:
        outcome, *found = self.asked(method, words, int(feature))
        return bool(outcome and found[0])

    def _done(self, method: str, words: tuple[str, str], feature: int, *values: float) -> ReturnValue:
        return ReturnValue(self.asked(method, words, int(feature), *values)[0].code)


class FrameGrabberClient(ServiceClient[FrameGrabberMsgs], IFrameGrabberControls):
    """Sees by a camera, and sets it, as YARP's ``frameGrabber_nwc_yarp`` does.

    ``server`` is the port of the images, ``answers`` the one that answers (``<server>/rpc``); ``name`` is the own port,
    and ``<name>/rpc_client`` the one that asks; ``carrier`` is the images'; more as of `ServiceClient`.
    """

    def __init__(
        self, server: str, name: str = "", carrier: str = "", answers: str = "", *, stream: bool = True,
        **options: Unpack[ClientOptions],
    ) -> None:  # fmt: skip
        mine = name and f"{name}/rpc_client"
        super().__init__(FrameGrabberMsgs, answers or f"{server}/rpc", mine, **options)
        self._source, self._carrier = server, carrier
        self._reader = Reader(name, naming=options.get("naming")) if stream else None
        self._size = (0, 0)

    def open(self) -> Self:
        """Open the ports and connect them; errors as of `ServiceClient.open`."""
        super().open()
        with closed_on_failure(self):
            if self._reader is not None:
                self._reader.open()
                connections.connect(self._reader.core.naming, self._source, self._reader.name, self._carrier)
        return self

    def close(self) -> None:
        """Close the ports; who waits for an image hears of it."""
        if self._reader is not None:
            self._reader.close()
        super().close()

    def getImage(self, image: Any) -> ReturnValue:
        """Wait for the next picture, which ``image`` becomes; false once this is closed, or has no stream."""
        received = None if self._reader is None else self._reader.read()
        if received is None:
            return UNREACHED
        try:
            found = received.to(type(image))
        except WireError:
            return ReturnValue(ReturnCode.METHOD_FAILED)
        self._size = (found.width(), found.height())
        fill(image, found)
        return OK

    def width(self) -> int:
        """Columns of the last picture; 0 before one came."""
        return self._size[0]

    def height(self) -> int:
        """Rows of the last picture; 0 before one came."""
        return self._size[1]

    def asked(self, method: str, words: tuple[str, str], *arguments: float) -> tuple[Any, ...]:
        """The outcome and results of a method, of servers before 4.0 in their words."""
        if self.version is not None:
            return answered(getattr(self.remote, method), *arguments)
        action, what = words
        plain = [float(one) if isinstance(one, float) else int(one) for one in arguments]
        try:
            answer = self.ask([Vocab("fgc"), Vocab(action), Vocab(what), *plain])
        except (OSError, WireError):
            return (UNREACHED,)
        first = 4 if action == "has" else 3  # [fgc] [has] [feat] number value; [fgc] [feat] [is] value
        if answer[:1] == ["fail"] or (action != "set" and len(answer) <= first):
            return (ReturnValue(ReturnCode.METHOD_FAILED),)
        return (OK, *(answer[first:] if action != "set" else ()))
