"""Reasons why this package lacks names that the bindings of YARP have, and replacements for them."""

from __future__ import annotations

import re

_NAMES = {
    r"I\w+Raw|Deprecated\w+|Device(Driver|Responder)|(Stub)?DriverCreator|Drivers|IConfig|IWrapper|IMultipleWrapper": (
        "custom devices are C++ plugins: serve an interface with yarp.ServiceServer; clients are in yarp.PolyDriver"
    ),
    r"I(FrameGrabber|FrameWriter|RGBDSensor|VisualParams|Rgb|Depth)\w*|(cameraFeature|cameraDescriptor)\w*"
    r"|(YARP_FEATURE|MODE|BUS)_\w+": "no camera devices here: read a camera's port with BufferedPortImageRgb",
    r"IAnalogSensor|VOCAB_IANALOG": "no such devices here: read the sensor's port with BufferedPortVector",
    r"I(Three|Six|Orientation|Temperature|Position|Contact|Encoder|Skin|Linear)\w+(Sensors|s|Arrays|Patches)"
    r"|\w+_EXTENDED_INTERFACE|MAS_\w+": "no such devices here: read the sensors' port, <name>/measures:o",
    r"I(Cartesian|Gaze)\w*|(Cartesian|Gaze)Event\w*": (
        "no such devices here: use the controller's rpc port with RpcClient"
    ),
    r"I(Speech|ChatBot|Audio|SimulatedWorld)\w*|Pose6D|ColorRGB": (
        "no such devices here: use the server's rpc port with RpcClient"
    ),
    r"I(Pid|Impedance|JointFault|JointCoupling|ControlDebug|Torque|Motor|Amplifier|Current|PWM)\w*|Pid\w*|MotorTorque\w*"
    r"|I(Control|Position|Velocity|Encoders|AxisInfo|Interaction|Remote)\w*": (
        "not implemented by the devices here: use the board's rpc port with RpcClient"
    ),
    r"VOCAB_\w+": "create the number of a vocab with yarp.createVocab32('a', 'b')",
    r"\w*Clock": "programs run on system time: use yarp.now() and yarp.delay()",
    r"Semaphore|Mutex|RecursiveLock|Event": "use Python's threading",
    r"Random": "use Python's random or numpy",
    r"Run|SharedLibrary\w*|YarpPlugin\w*|Carriers?|NameStore|DummyConnector": "has no meaning in pure Python",
    r"NestedContact": "use NestedName",
    r"PortReaderBuffer\w*|PortWriterBuffer\w*": "use BufferedPort",
    r"PortablePair\w*|BinPortable\w*|WireLink|Wire|AbstractContactable|PortReaderCreator": ("write and read a Bottle"),
    r"SearchMonitor|SearchReport": "reads of a Property are not monitored here",
    r"RateThread": "use PeriodicThread",
    r"INavigation2D\w+Actions": "use INavigation2D, which has all of its methods",
    r"Map2D\w+Data": "use Map2DLocation and similar classes, which have these fields",
    r"\w+Vector|VectorBase|vertex_t": "use a list",
    r"(Union)?Net(Int|Float)\w+|SwigPyIterator|(ALLOW|YARP_VERSION|YARP_RETURNVALUE|YARP_CROP)\w*|cvar|PAD_BYTES": (
        "specific to the C++ library"
    ),
    r"yarp_print_trace": "use Python's traceback",
}
"""Reasons by pattern of the name; the first pattern that matches is used."""

_METHODS = {
    r"\w+\.(\w*[mM]onitor\w*)": "reads are not monitored here",
    r"\w+\.([cr]?begin|[cr]?end|get_allocator|iterator)": ("a C++ iterator: use a for loop, list() or numpy.asarray()"),
    r"\w+\.erase": "takes C++ iterators: use del",
    r"Contact\.\w*Nested\w*": "use NestedName",
    r"(Unbuffered)?Contactable\.\w+": "use a Port, which has it",
    r"SoundMarker\.isEqual": "use ==",
    r"QosStyle\.get\w+ByVocab": "set the level or the number of the DSCP",
    r"Type\.\w+": "a type consists only of its name here",
    r"I[A-Z]\w+\.\w+": "not requested from servers here: use the server's rpc port with RpcClient",
    r"PolyDriver\.(link|give|take|getImplementation)": "a device has one PolyDriver: pass on that object",
    r"PolyDriver\.\w+": "pass all options to open()",
    r"RFModule\.getThreadKey|Value\.create": "specific to C++",
    r"(Network|NetworkBase)\.\w+": "configures the C++ library",
    r"Port\.\w+|BufferedPort\w*\.\w+|TypedReader\w*\.\w+": "specific to the threads of the C++ library",
    r"(Thread|PeriodicThread)\.\w+": "Python's threads have no priorities or statistics",
    r"Connection(Reader|Writer)\.\w+": "specific to the ports of the C++ library",
    r"Log\.\w+": "logs are not forwarded: use Python's logging",
}

DOCUMENTED = "which YARP may have: see docs/yarp/python.md"


def instead(name: str) -> str:
    """Return the reason for a missing name or method, ``Class.method``, with a replacement; "" if none is known."""
    patterns = _METHODS if "." in name else _NAMES
    return next((reason for pattern, reason in patterns.items() if re.fullmatch(pattern, name)), "")
