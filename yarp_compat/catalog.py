"""Finds the objects behind the package's names, and explains YARP's names that the package lacks."""

from __future__ import annotations

import importlib
import importlib.util
import re
from collections.abc import Mapping
from functools import cache
from typing import Any

from yarp_compat import absences

_NAMES = {
    "dev.drivers.polydriver": "PolyDriver",
    "dev.controlboard.modes": (
        "VOCAB_CM_IDLE VOCAB_CM_TORQUE VOCAB_CM_POSITION VOCAB_CM_POSITION_DIRECT VOCAB_CM_VELOCITY "
        "VOCAB_CM_VELOCITY_DIRECT VOCAB_CM_CURRENT VOCAB_CM_PWM VOCAB_CM_IMPEDANCE_POS VOCAB_CM_IMPEDANCE_VEL "
        "VOCAB_CM_MIXED VOCAB_CM_FORCE_IDLE VOCAB_CM_HW_FAULT VOCAB_CM_CALIBRATING VOCAB_CM_CALIB_DONE "
        "VOCAB_CM_NOT_CONFIGURED VOCAB_CM_CONFIGURED VOCAB_CM_UNKNOWN VOCAB_IM_STIFF VOCAB_IM_COMPLIANT "
        "VOCAB_IM_UNKNOWN VOCAB_JOINTTYPE_REVOLUTE VOCAB_JOINTTYPE_PRISMATIC VOCAB_JOINTTYPE_UNKNOWN"
    ),
    "dev.controlboard.views": (
        "IAmplifierControl IAxisInfo IControlLimits IControlMode ICurrentControl IEncoders IEncodersTimed "
        "IInteractionMode IMotor IMotorEncoders IPWMControl IPositionControl IPositionDirect IPreciselyTimed "
        "IRemoteVariables ITorqueControl IVelocityControl"
    ),
    "dev.basecontrol": "MobileBaseVelocity MobileBaseVelocityControl Odometry2DClient OdometryData",
    "dev.battery": "BatteryClient BatteryData IBattery",
    "dev.framegrabber": "BusType CameraDescriptor CameraFeature FeatureMode FrameGrabberClient IFrameGrabberControls",
    "dev.frametransform": "FrameTransform",
    "dev.frametransform_client": "TransformClient",
    "dev.iframetransform": "IFrameTransform",
    "dev.inavigation2d": (
        "Navigation2DServer NavigationMapTypeEnum NavigationStatusEnum TrajectoryTypeEnum statusToString stringToStatus"
    ),
    "dev.rangefinder": "LaserMeasurementData LaserScan2D",
    "dev.rangefinder_client": "IRangefinder2D Rangefinder2DClient",
    "dev.llm": "ILLM LLMClient LLMVector LLM_Message",
    "dev.localization2d": "ILocalization2D Localization2DClient Localization2DServer LocalizationStatusEnum",
    "dev.locations": "Map2DArea Map2DLocation Map2DLocationVector Map2DObject Map2DPath",
    "dev.map2d_client": "IMap2D Map2DClient",
    "dev.mapflag": "MapFlag",
    "dev.mapgrid": "MapGrid2D",
    "dev.mapinfo": "MapGrid2DInfo MapGrid2DOrigin",
    "dev.navigation2d_client": "INavigation2D Navigation2DClient",
    "dev.returnvalue": "CallFailed ReturnValue",
    "dev.server": "ServiceServer",
    "dev.client": "Stream",
    "octomap": "Octomap",
    "octree": "OcTree OctreeError",
    "os.data.bottle": "Bottle Property Searchable Value",
    "os.ports.buffered_port": "BufferedPort TypedReaderCallback",
    "os.ports.connection": "ConnectionReader ConnectionWriter PortInfo PortReport",
    "os.ports.contact": "Contact ContactStyle",
    "os.ports.contactable": "Contactable UnbufferedContactable",
    "os.directories": (
        "home tempdir datahome datadirs confighome configdirs cachehome runtimedir yarpdatahome yarpdatadirs "
        "yarpconfighome yarpconfigdirs yarpcachehome yarpruntimedir get_string get_path get_bool set_string set_path "
        "set_bool is_set unset getEnvironment setEnvironment unsetEnvironment path_separator"
    ),
    "os.log": "Log LogStream LogType",
    "os.ports.nested": "NestedName",
    "os.network": "Network NetworkBase",
    "os.ports.node": "Node Publisher Subscriber",
    "os.ports.port": "Port RpcClient RpcServer",
    "os.qos": "QosStyle",
    "os.resource_finder": "ResourceFinder",
    "os.resource_places": "ResourceFinderOptions",
    "os.rfmodule": "RFModule",
    "os.data.stamp": "Stamp",
    "os.data.stdvector": "BVector DVector IVector SPairVector SVector ShortVector",
    "os.things": "Things",
    "os.thread": "PeriodicThread Thread",
    "os.clock": "Time useNetworkClock",
    "os.time": (
        "now delay yield_c useSystemClock isSystemClock isNetworkClock isCustomClock isValid getClockType "
        "clockTypeToString isClockInitialized "
        "YARP_CLOCK_UNINITIALIZED YARP_CLOCK_DEFAULT YARP_CLOCK_SYSTEM YARP_CLOCK_NETWORK YARP_CLOCK_CUSTOM"
    ),
    "os.data.vocab": "Vocab Vocab32 Vocab64 createVocab createVocab32 createVocab64 encode decode encode64 decode64",
    "wire.portable": "Portable PortReader PortWriter",
    "wire.typename": "Type",
    "sig.image": (
        "Image FlexImage ImageMono ImageMono16 ImageRgb ImageRgba ImageBgr ImageBgra ImageInt ImageFloat ImageRgbFloat "
        "ImageRgbInt ImageRgbSigned ImageMonoSigned ImageHsv ImageHsvFloat"
    ),
    "sig.imagefile": "ImageFileFormat read write read_bytestream write_bytestream",
    "sig.matrix": "Matrix Quaternion removeCols removeRows submatrix",
    "sig.pixels": (
        "PixelCode PixelRgb PixelBgr PixelRgba PixelBgra PixelHsv PixelRgbSigned PixelRgbInt PixelRgbFloat "
        "PixelHsvFloat"
    ),
    "sig.pointcloud": (
        "PointCloud PointCloudXY PointCloudXYZ PointCloudXYZRGBA PointCloudXYZI PointCloudInterestPointXYZ "
        "PointCloudNormal PointCloudXYZNormal PointCloudXYZNormalRGBA"
    ),
    "sig.sound": "Sound SoundMarker",
    "sig.soundutils": "makeSawTooth makeSquareWave makeTone mix",
    "sig.vec2d": "Vec2D Vec2DInt Vec2DSize",
    "sig.vector": (
        "VectorOf Vector VectorFloat VectorInt VectorInt8 VectorInt16 VectorInt64 VectorUInt8 VectorUInt16 "
        "VectorUInt32 VectorUInt64"
    ),
}

_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names.split()}

_MODULES = ("aio", "rosmsg")

_FAMILIES = ("BufferedPort", "TypedReader")
"""``BufferedPortBottle`` is a ``BufferedPort`` of ``Bottle``, and for its readers a ``TypedReaderBottle``."""

_CALLBACK = "TypedReaderCallback"
"""Before 4.0, the bindings' name of ``SoundCallback`` was ``TypedReaderCallbackSound``."""

_ENUMERATOR = re.compile(
    r"(?:(?:Selectable)?ControlModeEnum|InteractionModeEnum|JointTypeEnum|cameraFeature_id_t|BusType|FeatureMode)_"
)
"""The prefixes of enumeration members in 4.0, which 3.x lacks."""

_ENUMERATORS = {
    "FORMAT_": "ImageFileFormat",
    "navigation_status_": "NavigationStatusEnum",
    "localization_status_": "LocalizationStatusEnum",
    "global_map": "NavigationMapTypeEnum",
    "local_map": "NavigationMapTypeEnum",
    "global_trajectory": "TrajectoryTypeEnum",
    "local_trajectory": "TrajectoryTypeEnum",
}
"""Enumerations whose members are names of the bindings' module, by the members' prefixes."""


_NEED_NUMPY = ("sig.", "dev.", "octomap", "octree")


def find(name: str) -> Any:
    """Return the object of a name; raises `AttributeError`, which suggests a replacement for a missing name."""
    if name in _MODULE_OF:
        return getattr(importlib.import_module(f"yarp_compat.{_MODULE_OF[name]}"), name)
    if name in _MODULES:
        return importlib.import_module(f"yarp_compat.{name}")
    if name in _constants():
        return _constants()[name]
    if not name.startswith("_"):
        value = _of_family(name)
        if value is not None:
            return value
    raise AttributeError(_absence(name))


def names() -> list[str]:
    """Return all names, except members of families and constants."""
    return [*_MODULE_OF, *_MODULES]


def everything() -> list[str]:
    """Return the names for ``from yarp import *``, including members of families and constants.

    Without numpy, names that need it are left out.
    """
    if importlib.util.find_spec("numpy") is None:
        return [name for name, module in _MODULE_OF.items() if not module.startswith(_NEED_NUMPY)]
    data = [name for name in _MODULE_OF if name[0].isupper() and _is_data(name)]
    members = [f"{family}{name}" for family in (*_FAMILIES, _CALLBACK) for name in data]
    members += [f"{name}Callback" for name in data]
    for start, kind in _ENUMERATORS.items():
        members += [member for member in find(kind).__members__ if member.startswith(start)]
    members += [f"VOCAB_PIXEL_{code}" for code in find("PixelCode").__members__]
    return sorted({*_MODULE_OF, *members, *_constants()})


def _constants() -> Mapping[str, int | str]:
    constants = importlib.import_module("yarp_compat.constants")
    table: Mapping[str, int | str] = constants.table()
    return table


def _of_family(name: str) -> Any:
    """Return ``BufferedPortBottle``, ``TypedReaderBottle``, ``BottleCallback``, or old ``Network_connect``."""
    family_class = _family_class(name)
    if family_class is not None:
        return family_class
    if (member := _ENUMERATOR.match(name)) is not None:
        return find(name[member.end() :])
    if name.startswith("VOCAB_PIXEL_"):
        return getattr(find("PixelCode"), name.removeprefix("VOCAB_PIXEL_"), None)
    for start, kind in _ENUMERATORS.items():
        if name.startswith(start):
            return getattr(find(kind), name, None)
    owner, _, method = name.partition("_")
    if method and owner in _MODULE_OF:
        return getattr(find(owner), method, None)
    return None


@cache
def _family_class(name: str) -> Any:
    """Return the class of a family for one kind of data, created at first use; None if the name is of no family."""
    common = {"__module__": "yarp_compat"}  # the module for pickle
    for family in _FAMILIES:
        if name.startswith(family) and _is_data(data := name.removeprefix(family)):
            base = find("BufferedPort") if family == "TypedReader" else _family_class(f"TypedReader{data}")
            return type(name, (base,), {"CONTENT": find(data), "__doc__": f"A BufferedPort of {data}.", **common})
    if name.startswith(_CALLBACK) and _is_data(name.removeprefix(_CALLBACK)):
        return _family_class(name.removeprefix(_CALLBACK) + "Callback")
    data = name.removesuffix("Callback")
    if data != name and _is_data(data):
        return type(
            name, (find("TypedReaderCallback"),), {"__doc__": f"A callback for a BufferedPort{data}.", **common}
        )
    return None


def _is_data(name: str) -> bool:
    return name in _MODULE_OF and hasattr(find(name), "from_wire")


def _absence(name: str) -> str:
    error = f"yarp_compat has no {name!r}"
    replacement = absences.instead(name)
    if replacement:
        return f"{error}: {replacement}"
    import difflib

    close = difflib.get_close_matches(name, names(), 1)
    return f"{error}: did you mean {close[0]!r}?" if close else f"{error}, {absences.DOCUMENTED}"
