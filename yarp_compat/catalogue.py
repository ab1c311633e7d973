"""Where each name of the package is, and what is said of YARP's names that are not there."""

from __future__ import annotations

import importlib
import re
from typing import Any

_PLACES = {
    "dev.basecontrol": "MobileBaseVelocityControl Odometry2DClient",
    "dev.frametransform": "FrameTransform",
    "dev.frametransform_client": "TransformClient",
    "dev.iframetransform": "IFrameTransform",
    "dev.ilocalization2d": "LocalizationStatusEnum",
    "dev.inavigation2d": "NavigationMapTypeEnum NavigationStatusEnum TrajectoryTypeEnum statusToString stringToStatus",
    "dev.laserscan": "LaserMeasurementData LaserScan2D",
    "dev.localization2d_client": "ILocalization2D Localization2DClient",
    "dev.localization2d_server": "Localization2DServer",
    "dev.locations": "Map2DArea Map2DLocation Map2DObject Map2DPath",
    "dev.map2d_client": "IMap2D Map2DClient",
    "dev.mapflag": "MapFlag",
    "dev.mapgrid": "MapGrid2D",
    "dev.mapinfo": "MapGrid2DInfo MapGrid2DOrigin",
    "dev.navigation2d": "INavigation2D",
    "dev.navigation2d_client": "Navigation2DClient",
    "dev.navigation2d_server": "Navigation2DServer",
    "dev.odometry": "MobileBaseVelocity OdometryData",
    "dev.returnvalue": "CallFailed ReturnValue",
    "dev.service_server": "ServiceServer",
    "dev.stream": "Stream",
    "os.bottle": "Bottle",
    "os.buffered_port": "BufferedPort",
    "os.callback": "TypedReaderCallback",
    "os.connection": "ConnectionReader ConnectionWriter PortReader",
    "os.contact": "Contact ContactStyle",
    "os.log": "Log LogType",
    "os.nested": "NestedName",
    "os.network": "Network NetworkBase",
    "os.node": "Node Publisher Subscriber",
    "os.port": "Port",
    "os.property": "Property",
    "os.report": "PortInfo PortReport",
    "os.resource_finder": "ResourceFinder ResourceFinderOptions",
    "os.rfmodule": "RFModule",
    "os.rpc": "RpcClient RpcServer",
    "os.stamp": "Stamp",
    "os.stdvector": "BVector DVector IVector SVector ShortVector",
    "os.thread": "PeriodicThread Thread",
    "os.time": (
        "Time now delay yield_c useSystemClock useNetworkClock isSystemClock isNetworkClock isCustomClock isValid "
        "YARP_CLOCK_UNINITIALIZED YARP_CLOCK_DEFAULT YARP_CLOCK_SYSTEM YARP_CLOCK_NETWORK YARP_CLOCK_CUSTOM"
    ),
    "os.value": "Value",
    "os.vocab": "Vocab Vocab32 Vocab64 createVocab32 encode decode",
    "sig.image": (
        "Image FlexImage ImageMono ImageMono16 ImageRgb ImageRgba ImageBgr ImageBgra ImageInt ImageFloat ImageRgbFloat "
        "ImageRgbInt ImageRgbSigned ImageMonoSigned ImageHsv ImageHsvFloat"
    ),
    "sig.matrix": "Matrix",
    "sig.pixels": (
        "PixelCode PixelRgb PixelBgr PixelRgba PixelBgra PixelHsv PixelRgbSigned PixelRgbInt PixelRgbFloat "
        "PixelHsvFloat"
    ),
    "sig.pointcloud": (
        "PointCloud PointCloudXY PointCloudXYZ PointCloudXYZRGBA PointCloudXYZI PointCloudInterestPointXYZ "
        "PointCloudNormal PointCloudXYZNormal PointCloudXYZNormalRGBA"
    ),
    "sig.quaternion": "Quaternion",
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

_INSTEAD = {
    r"PolyDriver|Drivers|IFrame(Grabber|Writer).*|I[A-Z]\w*(Control|Encoders|Sensor|Limits|Info|Mode)\w*": (
        "there are no device drivers in pure Python; talk to a device's ports, or use the clients of yarp_compat.dev"
    ),
    r"\w*(Clock)": "programs run on system time: use yarp.now() and yarp.delay()",
    r"Semaphore|Mutex|RecursiveLock|Event": "use Python's threading",
    r"Random": "use Python's random or numpy",
    r"Run|SharedLibrary\w*|YarpPlugin\w*|Carriers?": "it has no meaning in pure Python",
    r"NestedContact": "use NestedName",
    r"PortReaderBuffer\w*|PortWriterBuffer\w*": "use BufferedPort",
    r"QosStyle": "quality of service is not set on connections here",
    r"Things|Portable|BinPortable\w*|WireLink|Wire": "write and read a Bottle",
    r"RateThread": "use PeriodicThread",
}


def find(name: str) -> Any:
    """What a name of the package stands for.

    Raises:
        AttributeError: it is not there; saying what is there instead where that is known.
    """
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
    """Every name there is, but for the families' members."""
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
    for pattern, instead in _INSTEAD.items():
        if re.fullmatch(pattern, name):
            return f"{said}: {instead}"
    import difflib

    close = difflib.get_close_matches(name, names(), 1)
    return f"{said}: did you mean {close[0]!r}?" if close else f"{said}, which YARP may have: see docs/yarp_python.md"
