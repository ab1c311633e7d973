"""A class for a robot whose parts are devices, each of which may be missing."""

import yarp


class MissingPartError(Exception):
    """A device could not be opened."""


class Part:
    """A device with its name and remote port."""

    def __init__(self, device, remote) -> None:
        self._properties = yarp.Property()
        self._properties.put("device", device)
        self._properties.put("local", "/parts" + remote)
        self._properties.put("remote", remote)
        self._driver = yarp.PolyDriver()
        if not self._driver.open(self._properties):
            raise MissingPartError(device)

    def view(self, interface):
        return getattr(self._driver, "view" + interface)()

    def close(self):
        self._driver.close()


class Robot:
    def __init__(self) -> None:
        self.parts = {}
        for name, device, remote in (
            ("battery", "batteryClient", "/robot/battery"),
            ("laser", "Rangefinder2DClient", "/robot/laser:o"),
            ("camera", "frameGrabber_nwc_yarp", "/robot/camera"),
            ("gaze", "gazecontrollerclient", "/robot/gaze"),
            ("arm", "batteryClient", "/robot/arm"),
        ):
            try:
                self.parts[name] = Part(device, remote)
            except MissingPartError as missing:
                print(name, "is missing:", missing)

    def close(self):
        for part in self.parts.values():
            part.close()


yarp.Network.init()
robot = Robot()
print(" ".join(robot.parts))
battery = robot.parts["battery"].view("IBattery")
while battery.getBatteryCharge() == 0:
    yarp.delay(0.01)
print(f"{battery.getBatteryCharge():.0f} % {battery.getBatteryVoltage():.1f} V", battery.getBatteryInfo())
print(battery.getBatteryStatus() == yarp.IBattery.BATTERY_OK_IN_USE)
laser, scan = robot.parts["laser"].view("IRangefinder2D"), yarp.Vector()
while not laser.getRawData(scan):
    yarp.delay(0.01)
print("nearest", min(scan))
camera, image = robot.parts["camera"].view("IFrameGrabberImage"), yarp.ImageRgb()
print(bool(camera.getImage(image)), image.width(), image.height())
controls = robot.parts["camera"].view("IFrameGrabberControls")
if controls.hasFeature(yarp.YARP_FEATURE_ZOOM):
    controls.setFeature(yarp.YARP_FEATURE_ZOOM, 2.5)
print("zoom", controls.getFeature(yarp.YARP_FEATURE_ZOOM))
print(robot.parts["battery"].view("IGazeControl"))
robot.close()
yarp.Network.fini()
