"""Creates classes for ROS 1 types that are not installed, for real rospy programs, with genpy."""

import atexit
import hashlib
import shutil
import tempfile
from unittest import mock

import genmsg
import genpy.dynamic
import roslib.message
from genmsg.gentools import compute_md5_text

DEFINED = {}


def define(name, definition):
    """Create and store the classes of a type and its nested types from a full definition; a service has ``---``."""
    classes = {name: service_class(name, definition)} if "\n---\n" in definition else message_classes(name, definition)
    DEFINED.update(classes)
    return classes[name]


def message_class(name):
    """Return a message's class, preferring a defined one over an installed one."""
    cls = DEFINED.get(name) or roslib.message.get_message_class(name)
    if cls is None:
        raise ValueError(f"no type {name}: install its package, or define it")
    return cls


def service_type(name):
    """Return a service's class, preferring a defined one over an installed one."""
    return DEFINED.get(name) or roslib.message.get_service_class(name)


def message_classes(name, definition):
    """Return the classes of a message and its nested types by name, from a full definition as in connection headers.

    The folder that genpy writes is deleted at once, so that it is not left behind if the program is killed.
    """
    with tempfile.TemporaryDirectory() as folder, mock.patch.object(tempfile, "tempdir", folder):
        classes = genpy.dynamic.generate_dynamic(name, definition)
    atexit.unregister(shutil.rmtree)
    return classes


def service_class(name, definition):
    """Return a service's class, from the full definitions of request and response separated by a line ``---``."""
    kinds, texts = [], []
    for part, text in zip(("Request", "Response"), definition.split("\n---\n"), strict=True):
        classes = message_classes(name + part, text)
        kinds.append(classes[name + part])
        context = genmsg.MsgContext.create_default()
        for nested, cls in classes.items():
            context.register(nested, cls._spec)
        texts.append(compute_md5_text(context, kinds[-1]._spec))
    md5 = hashlib.md5("".join(texts).encode()).hexdigest()
    request, response = kinds
    attributes = {"_type": name, "_md5sum": md5, "_request_class": request, "_response_class": response}
    for kind in kinds:
        kind._md5sum = md5
    return type(name.rpartition("/")[2], (), attributes)
