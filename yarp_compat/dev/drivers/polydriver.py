"""``PolyDriver``: opens a device by its name, and returns its interfaces (`yarp/dev/PolyDriver.h`, ``yarp.i``).

    options = yarp.Property()
    options.put("device", "navigation2D_nwc_yarp")
    options.put("local", "/my_script")
    options.put("navigation_server", "/navigation2D_nws_yarp") ...
    driver = yarp.PolyDriver(options)
    if driver.isValid():
        robot = driver.viewINavigation2D()

For the supported devices, and how to add one, see `yarp_compat.dev.drivers.registry`.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from typing import Any

from yarp_compat.dev.drivers import registry
from yarp_compat.dev.drivers.registry import DeviceError, DeviceOptions, OpenDevice
from yarp_compat.dev.returnvalue import CallFailed
from yarp_compat.os.data.bottle import Property, Searchable
from yarp_compat.os.runtime import RUNTIME
from yarp_compat.wire.errors import WireError

log = logging.getLogger("yarp.dev.PolyDriver")


def _view(interface: str) -> Callable[[PolyDriver], Any]:
    def view(self: PolyDriver) -> Any:
        return self._get_view(interface)

    view.__doc__ = f"Return the device's {interface}; None if the device has none, or is not open."
    return view


class PolyDriver:
    """A device of any kind. It is closed, and its views end, at the latest when this object is garbage collected."""

    def __init__(self, config: Searchable | str | None = None) -> None:
        self._device: OpenDevice | None = None
        self._name = ""
        self._used = False
        if config is not None:
            self.open(config)

    def open(self, config: Searchable | str) -> bool:
        """Open the device named by the option ``device`` with the other options, or a device by its name only.

        Returns False and logs the reason on failure, for example if a device is already open.
        """
        if self._device is not None:
            log.error("the device %s is already open: close it first", self._name)
            return False
        if isinstance(config, str):
            config = Property({"device": config})
        self._used = True
        self._name = config.find("device").toString() or config.toString()
        try:
            self._device = self._open_device(config)
        except (DeviceError, CallFailed, OSError, WireError, ValueError) as error:
            log.error("the device <%s> could not be opened: %s", self._name, error)
            return False
        RUNTIME.opened(self)
        return True

    def open_str(self, device: str) -> bool:
        """Open a device by its name only; this is the bindings' name for an overload of `open`."""
        return self.open(device)

    def close(self) -> bool:
        """Close the device; False if `open` was not called since the last `close`."""
        device, self._device = self._device, None
        used, self._used = self._used, False
        if device is not None:
            RUNTIME.closed(self)
            device.close()
        return used

    def isValid(self) -> bool:
        """Whether a device is open."""
        return self._device is not None

    def id(self) -> str:
        """Return the device's name; empty before `open`."""
        return self._name

    viewIBattery = _view("IBattery")
    viewIFrameGrabberControls = _view("IFrameGrabberControls")
    viewIFrameGrabberImage = _view("IFrameGrabberImage")
    viewIFrameTransform = _view("IFrameTransform")
    viewILLM = _view("ILLM")
    viewILocalization2D = _view("ILocalization2D")
    viewIMap2D = _view("IMap2D")
    viewINavigation2D = _view("INavigation2D")
    viewINavigation2DVelocityActions = _view("INavigation2DVelocityActions")
    viewIOdometry2D = _view("IOdometry2D")
    viewIRangefinder2D = _view("IRangefinder2D")

    viewIAmplifierControl = _view("IAmplifierControl")
    viewIAxisInfo = _view("IAxisInfo")
    viewIControlLimits = _view("IControlLimits")
    viewIControlMode = _view("IControlMode")
    viewICurrentControl = _view("ICurrentControl")
    viewIEncoders = _view("IEncoders")
    viewIEncodersTimed = _view("IEncodersTimed")
    viewIInteractionMode = _view("IInteractionMode")
    viewIMotor = _view("IMotor")
    viewIMotorEncoders = _view("IMotorEncoders")
    viewIPWMControl = _view("IPWMControl")
    viewIPositionControl = _view("IPositionControl")
    viewIPositionDirect = _view("IPositionDirect")
    viewIPreciselyTimed = _view("IPreciselyTimed")
    viewIRemoteVariables = _view("IRemoteVariables")
    viewITorqueControl = _view("ITorqueControl")
    viewIVelocityControl = _view("IVelocityControl")

    def _open_device(self, config: Searchable) -> OpenDevice:
        make = registry.factory(self._name)
        if not RUNTIME.is_up:
            raise DeviceError("YARP not initialized; call yarp.Network.init() before opening devices")
        return make(DeviceOptions(self._name, config))

    def _get_view(self, interface: str) -> Any:
        if self._device is None:
            log.error("no %s: no device is open", interface)
            return None
        if interface not in self._device.views:
            log.warning("the device <%s> has no %s here, only %s", self._name, interface, ", ".join(self._device.views))
            return None
        return self._device.views[interface]

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # at interpreter exit, modules that are needed to close it may be gone
            if self._device is not None:
                log.info("the device <%s> is closed: its PolyDriver was garbage collected", self._name)
            self.close()


_OTHERS = """
IAnalogSensor ICartesianControl IContactLoadCellArrays IEncoderArrays IGazeControl IImpedanceControl IJointCoupling
IJointFault IOrientationSensors IPidControl IRGBDSensor ISimulatedWorld ISixAxisForceTorqueSensors ISkinPatches
ISpeechSynthesizer ISpeechTranscription ITemperatureSensors IThreeAxisGyroscopes IThreeAxisLinearAccelerometers
IThreeAxisMagnetometers
"""
"""Other views of the bindings (``yarp.i`` of 3.9 to 4.0): always None, because no device here has them."""

for _interface in _OTHERS.split():
    setattr(PolyDriver, f"view{_interface}", _view(_interface))
