"""Classes of ROS 1 types that are not installed, for real rospy programs: genpy makes them from definitions."""

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
    """Make a type's class from its full definition, and remember it with all that it nests; a service has a ``---``."""
    made = {name: service_class(name, definition)} if "\n---\n" in definition else message_classes(name, definition)
    DEFINED.update(made)
    return made[name]


def message_class(name):
    """Return a message's class: a defined one, else an installed one."""
    cls = DEFINED.get(name) or roslib.message.get_message_class(name)
    if cls is None:
        raise ValueError(f"no type {name}: install its package, or define it")
    return cls


def service_type(name):
    """Return a service's class: a defined one, else an installed one."""
    return DEFINED.get(name) or roslib.message.get_service_class(name)


def message_classes(name, definition):
    """Of a message and all that it nests, by name; of a full text as connection headers have it.

    The folder that genpy writes is deleted at once, not only if the program ends by itself.
    """
    with tempfile.TemporaryDirectory() as folder, mock.patch.object(tempfile, "tempdir", folder):
        made = genpy.dynamic.generate_dynamic(name, definition)
    atexit.unregister(shutil.rmtree)
    return made


def service_class(name, definition):
    """Of a service: the full texts of request and response with a line ``---`` between them."""
    kinds, texts = [], []
    for part, text in zip(("Request", "Response"), definition.split("\n---\n"), strict=True):
        classes = message_classes(name + part, text)
        kinds.append(classes[name + part])
        context = genmsg.MsgContext.create_default()
        for one, cls in classes.items():
            context.register(one, cls._spec)
        texts.append(compute_md5_text(context, kinds[-1]._spec))
    md5 = hashlib.md5("".join(texts).encode()).hexdigest()
    request, response = kinds
    words = {"_type": name, "_md5sum": md5, "_request_class": request, "_response_class": response}
    for kind in kinds:
        kind._md5sum = md5
    return type(name.rpartition("/")[2], (), words)
