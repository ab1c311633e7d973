"""The module of each name of the package, and the error for YARP's names that it lacks."""

from __future__ import annotations

import importlib
from typing import Any

from yarp_compat import absences

_PLACES = {
    "dev.drivers.polydriver": "PolyDriver",
    "dev.basecontrol": "MobileBaseVelocity MobileBaseVelocityControl Odometry2DClient OdometryData",
    "dev.battery": "BatteryClient BatteryData IBattery",
    "dev.frametransform": "FrameTransform",
    "dev.frametransform_client": "TransformClient",
    "dev.iframetransform": "IFrameTransform",
    "dev.inavigation2d": (
        "Navigation2DServer NavigationMapTypeEnum NavigationStatusEnum TrajectoryTypeEnum statusToString stringToStatus"
    ),
    "dev.rangefinder": "LaserMeasurementData LaserScan2D",
    "dev.rangefinder_client": "IRangefinder2D Rangefinder2DClient",
    "dev.localization2d": "ILocalization2D Localization2DClient Localization2DServer LocalizationStatusEnum",
    "dev.locations": "Map2DArea Map2DLocation Map2DObject Map2DPath",
    "dev.map2d_client": "IMap2D Map2DClient",
    "dev.mapflag": "MapFlag",
    "dev.mapgrid": "MapGrid2D",
    "dev.mapinfo": "MapGrid2DInfo MapGrid2DOrigin",
    "dev.navigation2d_client": "INavigation2D Navigation2DClient",
    "dev.returnvalue": "CallFailed ReturnValue",
    "dev.server": "ServiceServer",
    "dev.client": "Stream",
    "os.data.bottle": "Bottle Property Value",
    "os.ports.buffered_port": "BufferedPort TypedReaderCallback",
    "os.ports.connection": "ConnectionReader ConnectionWriter PortInfo PortReader PortReport",
    "os.ports.contact": "Contact ContactStyle",
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
    "os.resource_finder": "ResourceFinder",
    "os.resource_places": "ResourceFinderOptions",
    "os.rfmodule": "RFModule",
    "os.data.stamp": "Stamp",
    "os.data.stdvector": "BVector DVector IVector SVector ShortVector",
    "os.thread": "PeriodicThread Thread",
    "os.clock": "Time useNetworkClock",
    "os.time": (
        "now delay yield_c useSystemClock isSystemClock isNetworkClock isCustomClock isValid "
        "YARP_CLOCK_UNINITIALIZED YARP_CLOCK_DEFAULT YARP_CLOCK_SYSTEM YARP_CLOCK_NETWORK YARP_CLOCK_CUSTOM"
    ),
    "os.data.vocab": "Vocab Vocab32 Vocab64 createVocab32 encode decode",
    "sig.image": (
        "Image FlexImage ImageMono ImageMono16 ImageRgb ImageRgba ImageBgr ImageBgra ImageInt ImageFloat ImageRgbFloat "
        "ImageRgbInt ImageRgbSigned ImageMonoSigned ImageHsv ImageHsvFloat"
    ),
    "sig.matrix": "Matrix Quaternion",
    "sig.pixels": (
        "PixelCode PixelRgb PixelBgr PixelRgba PixelBgra PixelHsv PixelRgbSigned PixelRgbInt PixelRgbFloat "
        "PixelHsvFloat"
    ),
    "sig.pointcloud": (
        "PointCloud PointCloudXY PointCloudXYZ PointCloudXYZRGBA PointCloudXYZI PointCloudInterestPointXYZ "
        "PointCloudNormal PointCloudXYZNormal PointCloudXYZNormalRGBA"
    ),
    "sig.sound": "Sound",
    "sig.vec2d": "Vec2D Vec2DInt Vec2DSize",
    "sig.vector": (
        "VectorOf Vector VectorFloat VectorInt VectorInt8 VectorInt16 VectorInt64 VectorUInt8 VectorUInt16 "
        "VectorUInt32 VectorUInt64"
    ),
}

_WHERE = {name: module for module, names in _PLACES.items() for name in names.split()}

_MODULES = ("aio", "rosmsg")

_FAMILIES = ("BufferedPort", "TypedReader")
"""``BufferedPortBottle`` is a ``BufferedPort`` of ``Bottle``; to who reads, that is a ``TypedReaderBottle``."""

_ENUMERATORS = {
    "navigation_status_": "NavigationStatusEnum",
    "localization_status_": "LocalizationStatusEnum",
    "global_map": "NavigationMapTypeEnum",
    "local_map": "NavigationMapTypeEnum",
    "global_trajectory": "TrajectoryTypeEnum",
    "local_trajectory": "TrajectoryTypeEnum",
}
"""Enumerations whose members the bindings give by themselves: what they begin with."""


def find(name: str) -> Any:
    """The object of a name of the package; raises `AttributeError`, which names the substitute of an absent one."""
    if name in _WHERE:
        return getattr(importlib.import_module(f"yarp_compat.{_WHERE[name]}"), name)
    if name in _MODULES:
        return importlib.import_module(f"yarp_compat.{name}")
    if not name.startswith("_"):
        made = _of_family(name)
        if made is not None:
            return made
    raise AttributeError(_absence(name))


def names() -> list[str]:
    """Every name, except the families' members."""
    return [*_WHERE, *_MODULES]


def _of_family(name: str) -> Any:
    """``BufferedPortBottle``, ``TypedReaderBottle``, ``BottleCallback``; ``Network_connect`` as in old bindings."""
    for family in _FAMILIES:
        if name.startswith(family) and _is_data(name.removeprefix(family)):
            content = find(name.removeprefix(family))
            base = find("BufferedPort")
            return type(name, (base,), {"CONTENT": content, "__doc__": f"A BufferedPort of {content.__name__}."})
    data = name.removesuffix("Callback")
    if data != name and _is_data(data):
        return type(name, (find("TypedReaderCallback"),), {"__doc__": f"A callback for a BufferedPort{data}."})
    if name.startswith("VOCAB_PIXEL_"):
        return getattr(find("PixelCode"), name.removeprefix("VOCAB_PIXEL_"), None)
    for start, kind in _ENUMERATORS.items():
        if name.startswith(start):
            return getattr(find(kind), name, None)
    owner, _, method = name.partition("_")
    if method and owner in _WHERE:
        return getattr(find(owner), method, None)
    return None


def _is_data(name: str) -> bool:
    return name in _WHERE and hasattr(find(name), "from_wire")


def _absence(name: str) -> str:
    said = f"yarp_compat has no {name!r}"
    other = absences.instead(name)
    if other:
        return f"{said}: {other}"
    import difflib

    close = difflib.get_close_matches(name, names(), 1)
    return f"{said}: did you mean {close[0]!r}?" if close else f"{said}, {absences.DOCUMENTED}"
