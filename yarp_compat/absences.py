"""What YARP's bindings have and this package lacks: why, and what there is instead."""

from __future__ import annotations

import re

_NAMES = {
    r"I\w+Raw|Deprecated\w+|Device(Driver|Responder)|(Stub)?DriverCreator|Drivers|IConfig|IWrapper|IMultipleWrapper": (
        "devices of one's own are C++ plugins: serve an interface by yarp.ServiceServer; clients are in yarp.PolyDriver"
    ),
    r"I(FrameGrabber|FrameWriter|RGBDSensor|VisualParams|Rgb|Depth)\w*|(cameraFeature|cameraDescriptor)\w*"
    r"|(YARP_FEATURE|MODE|BUS)_\w+": "there are no cameras as devices: read a camera's port by BufferedPortImageRgb",
    r"IAnalogSensor|VOCAB_IANALOG": "there are no such devices: read the sensor's port by BufferedPortVector",
    r"I(Three|Six|Orientation|Temperature|Position|Contact|Encoder|Skin|Linear)\w+(Sensors|s|Arrays|Patches)"
    r"|\w+_EXTENDED_INTERFACE|MAS_\w+": "there are no such devices: read the sensors' port, <name>/measures:o",
    r"I(Cartesian|Gaze)\w*|(Cartesian|Gaze)Event\w*": (
        "there are no such devices: ask the controller's rpc port by RpcClient"
    ),
    r"I(Speech|ChatBot|Audio|SimulatedWorld)\w*|Pose6D|ColorRGB": (
        "there are no such devices: ask the server's rpc port by RpcClient"
    ),
    r"I(Pid|Impedance|JointFault|JointCoupling|ControlDebug|Torque|Motor|Amplifier|Current|PWM)\w*|Pid\w*|MotorTorque\w*"
    r"|I(Control|Position|Velocity|Encoders|AxisInfo|Interaction|Remote)\w*": (
        "no device here has it: ask the board's rpc port by RpcClient"
    ),
    r"VOCAB_\w+": "make the number of a word by yarp.createVocab32('a', 'b')",
    r"\w*Clock": "programs run on system time: use yarp.now() and yarp.delay()",
    r"Semaphore|Mutex|RecursiveLock|Event": "use Python's threading",
    r"Random": "use Python's random or numpy",
    r"Run|SharedLibrary\w*|YarpPlugin\w*|Carriers?|NameStore|DummyConnector": "it has no meaning in pure Python",
    r"NestedContact": "use NestedName",
    r"PortReaderBuffer\w*|PortWriterBuffer\w*": "use BufferedPort",
    r"PortablePair\w*|BinPortable\w*|WireLink|Wire|AbstractContactable|PortReaderCreator": ("write and read a Bottle"),
    r"SearchMonitor|SearchReport": "who reads a Property is not followed here",
    r"RateThread": "use PeriodicThread",
    r"INavigation2D\w+Actions": "use INavigation2D, which has all of its methods",
    r"Map2D\w+Data": "use Map2DLocation and its kin, which have its fields",
    r"\w+Vector|VectorBase|vertex_t": "use a list",
    r"(Union)?Net(Int|Float)\w+|SwigPyIterator|(ALLOW|YARP_VERSION|YARP_RETURNVALUE|YARP_CROP)\w*|cvar|PAD_BYTES": (
        "it is of the C++ library"
    ),
    r"yarp_print_trace": "use Python's traceback",
}
"""Patterns of names, and what is said of them; the first that fits counts."""

_METHODS = {
    r"\w+\.(\w*[mM]onitor\w*)": "who reads it is not followed here",
    r"\w+\.([cr]?begin|[cr]?end|get_allocator|iterator)": (
        "it is an iterator of C++: a for loop, list() and numpy.asarray() do the same"
    ),
    r"\w+\.erase": "it takes iterators of C++: del does the same",
    r"Contact\.\w*Nested\w*": "use NestedName",
    r"(Unbuffered)?Contactable\.\w+": "a Port has it",
    r"SoundMarker\.isEqual": "compare them by ==",
    r"QosStyle\.get\w+ByVocab": "give the level, or the number of the DSCP, itself",
    r"Type\.\w+": "a type is its name here",
    r"I[A-Z]\w+\.\w+": "nobody is asked that here: ask the server's rpc port by RpcClient",
    r"PolyDriver\.(link|give|take|getImplementation)": "a device has one PolyDriver: hand that on",
    r"PolyDriver\.\w+": "a device is told all when it is opened",
    r"RFModule\.getThreadKey|Value\.create": "it is for C++",
    r"(Network|NetworkBase)\.\w+": "it sets up the C++ library",
    r"Port\.\w+|BufferedPort\w*\.\w+|TypedReader\w*\.\w+": "it is for C++'s own threads",
    r"(Thread|PeriodicThread)\.\w+": "Python's threads have no priorities and no such statistics",
    r"Connection(Reader|Writer)\.\w+": "it is for C++'s own ports",
    r"Log\.\w+": "logs are not forwarded: use Python's logging",
}

DOCUMENTED = "which YARP may have: see docs/yarp/python.md"


def instead(name: str) -> str:
    """What is said of an absent name, or of the method ``Class.method``; empty where nothing is."""
    patterns = _METHODS if "." in name else _NAMES
    return next((said for pattern, said in patterns.items() if re.fullmatch(pattern, name)), "")
