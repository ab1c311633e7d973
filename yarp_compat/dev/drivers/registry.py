"""The devices that `PolyDriver` opens, by YARP's names for them, and what to use in place of those that are not here.

A kind of device is added in two steps:

1. A *factory* in a module of its own, a function of `DeviceOptions` that returns an `OpenDevice`::

        def battery(options: DeviceOptions) -> OpenDevice:
            client = BatteryClient(options.port("remote"), options.port("local"), naming=options.naming).open()
            return OpenDevice(client.close, {"IBattery": client})

   It raises `DeviceError` for options that make no sense, and lets the errors of ports through (`OSError`,
   `WireError`); what it had opened by then it closes.
2. One line in `_FACTORIES`: all names that releases of YARP have for the device, and where the factory is. The module
   is imported when a device of these names is opened.

What a view gives (``viewIBattery()``) stands under the interface's name in ``views``. An interface that `PolyDriver`
does not list yet becomes one more line there.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import cast

from yarp_compat.os.data.bottle import Searchable, Value
from yarp_compat.os.runtime import RUNTIME
from yarp_compat.ports.naming import Naming
from yarp_compat.wire.contact import is_port_name, rooted

_FACTORIES = {
    "navigation2D_nwc_yarp navigation2DClient": "navigation.navigation2d",
    "localization2D_nwc_yarp localization2DClient": "navigation.localization2d",
    "map2D_nwc_yarp map2DClient": "navigation.map2d",
    "mobileBaseVelocityControl_nwc_yarp": "navigation.mobile_base_velocity_control",
    "frameTransformClient": "transforms.frame_transform_client",
    "frameTransform_nwc_yarp": "transforms.frame_transform",
    "transformClient": "transforms.transform_client",
    "rangefinder2D_nwc_yarp Rangefinder2DClient": "parts.rangefinder2d",
    "odometry2D_nwc_yarp": "parts.odometry2d",
    "battery_nwc_yarp batteryClient": "parts.battery",
    "controlBoard_nwc_yarp remote_controlboard controlboard_nwc_yarp": "parts.controlboard",
    "frameGrabber_nwc_yarp remote_grabber": "parts.frame_grabber",
    "LLM_nwc_yarp": "parts.llm",
}
"""The names of a device in YARP's releases, and its factory: a module of this package, and a function in it."""

_BY_NAME = {name: place for names, place in _FACTORIES.items() for name in names.split()}

_INSTEAD = {
    r"controlboardremapper|remotecontrolboardremapper": "open each board by a controlBoard_nwc_yarp of its own",
    r"(RGBD|rgbd).*": "read its images by BufferedPortImageRgb and BufferedPortImageFloat",
    r"frameTransform(Get|Set)_nwc_yarp": "frameTransform_nwc_yarp is both",
    r"(frameGrabber|grabber|usb|opencv|ffmpeg|openCV).*": "read the camera's port by BufferedPortImageRgb",
    r"analogsensorclient|AnalogSensorClient": "read the sensor's port by BufferedPortVector",
    r"multipleanalogsensors\w*": "read the sensors' port, <remote>/measures:o, by BufferedPortBottle",
    r"(cartesian|gaze)controllerclient|(Cartesian|Gaze).*": "ask the controller's rpc port by RpcClient",
    r"(speech|audio|chatBot).*_nwc_yarp": "ask its rpc port by RpcClient",
    r".*(_nws_\w+|Wrapper|Server)|controlboardwrapper2": (
        "servers of maps, places, frames, planners and localisers are modules of Midspan (docs/navigation/modules.md)"
    ),
    r"fake\w*|test_\w*": "it is made for YARP's own tests",
}


class DeviceError(Exception):
    """A device cannot be opened: it does not exist here, or its options make no sense."""


@dataclass(frozen=True)
class OpenDevice:
    """A device that a factory opened: what closes it, and what it is viewed as, by the interface's name."""

    close: Callable[[], object]
    views: Mapping[str, object]


Factory = Callable[["DeviceOptions"], OpenDevice]


class DeviceOptions:
    """The options of a device, as factories read them; errors say which option is wrong and what it is for."""

    def __init__(self, device: str, config: Searchable) -> None:
        self.device, self._config = device, config

    @property
    def naming(self) -> Naming:
        """The name server of this program's ports."""
        return RUNTIME.naming

    def has(self, key: str) -> bool:
        """Whether an option is given."""
        return self._config.check(key)

    def text(self, key: str, default: str | None = None) -> str:
        """A text; raises `DeviceError` where it is not given, or empty, and there is no default."""
        value = self._config.find(key)
        found = value.asString() if value.isString() else value.toString()
        if not found and default is None:
            said = f"is empty: {key} {found!r}" if self.has(key) else "is not given"
            raise DeviceError(f"the option {key!r} of {self.device} {said}")
        return found or default or ""

    def port(self, key: str, default: str | None = None) -> str:
        """The name of a port, or what ports' names begin with, with YARP's ``/`` before it; raises as `text`."""
        found = self.text(key, default)
        name = found if rooted(found) else f"/{found}"
        if not is_port_name(name):
            said = f"the option {key!r} of {self.device} names a port, as /robot/battery does, not {found!r}"
            raise DeviceError(said)
        return name

    def number(self, key: str, default: float) -> float:
        """A number; raises `DeviceError` for something else."""
        value = self._value(key)
        if value is None:
            return default
        if not (value.isInt64() or value.isFloat64() or value.isInt32()):
            raise DeviceError(f"the option {key!r} of {self.device} is a number, not {value.toString()}")
        return value.asFloat64()

    def flag(self, key: str, *, default: bool) -> bool:
        """Whether something is on: ``true``, ``1`` or ``on``; raises `DeviceError` for something else."""
        value = self._value(key)
        if value is None:
            return default
        said = value.toString().lower()
        if said not in _TRUTH:
            raise DeviceError(f"the option {key!r} of {self.device} is true or false, not {value.toString()}")
        return _TRUTH[said]

    def _value(self, key: str) -> Value | None:
        return self._config.find(key) if self.has(key) else None


_TRUTH = {"true": True, "1": True, "on": True, "yes": True, "false": False, "0": False, "off": False, "no": False}


def names() -> list[str]:
    """The names of all devices that there are."""
    return list(_BY_NAME)


def factory(device: str) -> Factory:
    """What opens a device; raises `DeviceError` where there is none of this name, which says what there is instead."""
    if device not in _BY_NAME:
        instead = next((said for names, said in _INSTEAD.items() if re.fullmatch(names, device)), "")
        raise DeviceError(f"there is no device {device!r} here; {instead or f'there are {_listed()}'}")
    module, _, name = _BY_NAME[device].partition(".")
    return cast("Factory", getattr(importlib.import_module(f"yarp_compat.dev.drivers.{module}"), name))


def _listed() -> str:
    return ", ".join(names.split()[0] for names in _FACTORIES)
