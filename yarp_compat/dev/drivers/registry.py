"""The devices that `PolyDriver` opens, by YARP's names, and replacements for devices that are not supported.

A kind of device is added in two steps:

1. A *factory* in its own module, a function of `DeviceOptions` that returns an `OpenDevice`::

        def battery(options: DeviceOptions) -> OpenDevice:
            client = BatteryClient(options.port("remote"), options.port("local"), naming=options.naming).open()
            return OpenDevice(client.close, {"IBattery": client})

   The factory raises `DeviceError` for invalid options, passes on the errors of ports (`OSError`, `WireError`), and on
   an error closes what it has opened.
2. One line in `_FACTORIES`: all names of the device in YARP's releases, and the location of the factory. Its module is
   imported when such a device is opened.

``views`` maps the interface's name to the object that a view (``viewIBattery()``) returns. An interface that
`PolyDriver` does not list yet needs one more line in that class.
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
    r"controlboardremapper|remotecontrolboardremapper": "open each board with its own controlBoard_nwc_yarp",
    r"(RGBD|rgbd).*": "read its images with BufferedPortImageRgb and BufferedPortImageFloat",
    r"frameTransform(Get|Set)_nwc_yarp": "use frameTransform_nwc_yarp for both",
    r"(frameGrabber|grabber|usb|opencv|ffmpeg|openCV).*": "read the camera's port with BufferedPortImageRgb",
    r"analogsensorclient|AnalogSensorClient": "read the sensor's port with BufferedPortVector",
    r"multipleanalogsensors\w*": "read the sensors' port, <remote>/measures:o, with BufferedPortBottle",
    r"(cartesian|gaze)controllerclient|(Cartesian|Gaze).*": "call the controller's rpc port with RpcClient",
    r"(speech|audio|chatBot).*_nwc_yarp": "call its rpc port with RpcClient",
    r".*(_nws_\w+|Wrapper|Server)|controlboardwrapper2": (
        "servers of maps, places, frames, planners and localizers are modules of Midspan (docs/navigation/modules.md)"
    ),
    r"fake\w*|test_\w*": "it only serves YARP's own tests",
}


class DeviceError(Exception):
    """Raised if a device cannot be opened: it is not supported, or its options are invalid."""


@dataclass(frozen=True)
class OpenDevice:
    """A device that a factory opened: its closing function, and its views by the interface's name."""

    close: Callable[[], object]
    views: Mapping[str, object]


Factory = Callable[["DeviceOptions"], OpenDevice]


class DeviceOptions:
    """The options of a device, for factories; errors name the invalid option and its expected value."""

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
        """Return a text; raises `DeviceError` if it is missing or empty and has no default."""
        value = self._config.find(key)
        text = value.asString() if value.isString() else value.toString()
        if not text and default is None:
            problem = f"is empty: {key} {text!r}" if self.has(key) else "is missing"
            raise DeviceError(f"the option {key!r} of {self.device} {problem}")
        return text or default or ""

    def port(self, key: str, default: str | None = None) -> str:
        """Return a port's name or prefix, with a leading ``/``; raises `DeviceError` like `text`."""
        text = self.text(key, default)
        name = text if rooted(text) else f"/{text}"
        if not is_port_name(name):
            raise DeviceError(f"the option {key!r} of {self.device} must be a port like /robot/battery, not {text!r}")
        return name

    def number(self, key: str, default: float) -> float:
        """Return a number; raises `DeviceError` for another type."""
        value = self._value(key)
        if value is None:
            return default
        if not (value.isInt64() or value.isFloat64() or value.isInt32()):
            raise DeviceError(f"the option {key!r} of {self.device} must be a number, not {value.toString()}")
        return value.asFloat64()

    def flag(self, key: str, *, default: bool) -> bool:
        """Whether an option is ``true``, ``1``, ``on`` or ``yes``; raises `DeviceError` if it is not a boolean."""
        value = self._value(key)
        if value is None:
            return default
        text = value.toString().lower()
        if text not in _TRUTH:
            raise DeviceError(f"the option {key!r} of {self.device} must be true or false, not {value.toString()}")
        return _TRUTH[text]

    def _value(self, key: str) -> Value | None:
        return self._config.find(key) if self.has(key) else None


_TRUTH = {"true": True, "1": True, "on": True, "yes": True, "false": False, "0": False, "off": False, "no": False}


def names() -> list[str]:
    """Return the names of all supported devices."""
    return list(_BY_NAME)


def factory(device: str) -> Factory:
    """Return the factory of a device; raises `DeviceError`, which names the replacement, for an unknown name."""
    if device not in _BY_NAME:
        instead = next((cure for names, cure in _INSTEAD.items() if re.fullmatch(names, device)), "")
        raise DeviceError(f"unknown device {device!r}; {instead or f'supported are {_listed()}'}")
    module, _, name = _BY_NAME[device].partition(".")
    return cast("Factory", getattr(importlib.import_module(f"yarp_compat.dev.drivers.{module}"), name))


def _listed() -> str:
    return ", ".join(names.split()[0] for names in _FACTORIES)
