"""The peer program of `tests.peers.peer` for ROS 1: a real rospy node on the system's Python, with only dist-packages.

Beyond the common commands: ``define`` type, definition (full text: own fields, then each nested type's after a line of
``=`` and ``MSG: name``; a service's request and response with a line ``---`` between) makes a type known that is not
installed; ``advertise`` and ``subscribe`` take ``queue``
(rospy's queue_size); ``header`` id -> headers of the last message of each publisher; ``connections`` id -> count;
``stall`` id: the subscription's callback for the next message waits for ``resume`` id; ``attempts`` topic -> count: how
often rospy has tried to connect to a publisher of the topic;
``parameters`` -> names; ``set_param`` name, value; ``get_param`` name -> value;
``now`` -> seconds: the node's time; with simulated time, 0 until /clock arrives;
``log`` text: to /rosout; ``await_service`` service, seconds: rospy's wait_for_service.

Messages are dicts of their fields; arrays of bytes are lists of integers, times are ``{"secs": .., "nsecs": ..}``.
Usage: peer.py NODE
"""
# ruff: noqa: A002, ANN003, ANN204  # parameters are named as in the commands; it runs without Midspan

import signal
import sys
import threading
from pathlib import Path

import genpy
import rosgraph
import rospy

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.commands import Calling, Commands, Counting, Record, only_answers, serve
from tests.peers.ros1.actions import Acting, Goal, action_client
from tests.peers.ros1.connector import Connector
from tests.peers.ros1.message_types import define, message_class, service_type
from tests.peers.ros1.shutdown import shut_down


def to_plain(value):
    """Return a message or field as JSON values."""
    if isinstance(value, genpy.Message):
        return {name: to_plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, (genpy.Time, genpy.Duration)):
        return {"secs": value.secs, "nsecs": value.nsecs}
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if isinstance(value, (list, tuple)) or hasattr(value, "tolist"):
        return [to_plain(v) for v in value]
    return value


def fill(message, fields):
    """Set a message's fields from a dict; fields that are not named keep their defaults."""
    for name, value in fields.items():
        if name not in message.__slots__:
            raise ValueError(f"{message._type} has no field {name}; it has {', '.join(message.__slots__)}")
        slot = message._slot_types[message.__slots__.index(name)]
        setattr(message, name, to_field(slot, value, getattr(message, name)))
    return message


def to_field(slot, value, default):
    """Return a field's value from JSON."""
    base, bracket, _ = slot.partition("[")
    if bracket:
        if base in ("uint8", "char"):
            return bytes(value)
        return [to_field(base, v, None) for v in value]
    if base == "time":
        return genpy.Time(value["secs"], value["nsecs"])
    if base == "duration":
        return genpy.Duration(value["secs"], value["nsecs"])
    if isinstance(value, dict):
        return fill(default if default is not None else message_class(full(base))(), value)
    return value


def full(name):
    """Return a type's full name."""
    return "std_msgs/Header" if name == "Header" else name


class Publisher(rospy.Publisher):
    drop = rospy.Publisher.unregister


class Subscriber(Record):
    """A subscriber that stores all messages, and the last connection header of each publisher."""

    def __init__(self, topic, cls, queue):
        super().__init__(to_plain)
        self.headers = {}
        self.free = threading.Event()
        self.free.set()
        self.endpoint = rospy.Subscriber(topic, cls, self.on_message, queue_size=queue, tcp_nodelay=True)

    def on_message(self, message):
        header = dict(message._connection_header)
        self.headers[header.get("callerid", "")] = header
        self.add(message)
        self.free.wait()

    def get_num_connections(self):
        return self.endpoint.get_num_connections()

    def drop(self):
        self.free.set()
        self.endpoint.unregister()


class Serving(Record):
    """A service with one answer to all requests."""

    def __init__(self, service, cls, reply, error, held):
        super().__init__()
        self.cls, self.reply, self.error = cls, reply, error
        self.released = threading.Event()
        if not held:
            self.released.set()
        self.service = rospy.Service(service, cls, self.on_request)

    def on_request(self, request):
        self.add(to_plain(request))
        self.released.wait()
        if self.error:
            raise rospy.ServiceException(self.error)
        return fill(self.cls._response_class(), self.reply)

    def release(self):
        self.released.set()

    def drop(self):
        self.released.set()
        self.service.shutdown("end of the test")


CONNECTOR = Connector()


class Peer(Commands):
    """Executes the commands."""

    def __init__(self):
        super().__init__()
        self.proxies, self.action_clients = {}, {}

    def define(self, type, definition):
        return {"md5": define(type, definition)._md5sum}

    def advertise(self, topic, type, latched=False, queue=100, **_):
        return self.add(Publisher(topic, message_class(type), latch=latched, queue_size=queue, tcp_nodelay=True))

    def publish(self, id, message, times=1):
        publisher = self.parts[id]
        filled = fill(publisher.data_class(), message)
        for _ in range(times):
            publisher.publish(filled)
        return {}

    def subscribe(self, topic, type, queue=None, **_):
        cls = rospy.AnyMsg if type == "*" else message_class(type)
        return self.add(Subscriber(topic, cls, queue))

    def broadcast(self, id, child, rate):
        message = fill(message_class("tf2_msgs/TFMessage")(), {"transforms": [{"child_frame_id": child}]})

        def publish(_text) -> None:
            message.transforms[0].header = fill(message_class("std_msgs/Header")(), {"frame_id": "map"})
            message.transforms[0].header.stamp = rospy.Time.now()
            message.transforms[0].transform.rotation.w = 1.0
            self.parts[id].publish(message)

        self.countings[id] = Counting(publish, 0, sys.maxsize, rate)
        return {}

    def stall(self, id):
        self.parts[id].free.clear()
        return {}

    def resume(self, id):
        self.parts[id].free.set()
        return {}

    def attempts(self, topic):
        return {"count": CONNECTOR.attempts(topic)}

    def header(self, id):
        return {"headers": self.parts[id].headers}

    def serve(self, service, type, reply=None, error="", held=False, **_):
        return self.add(Serving(service, service_type(type), reply or {}, error, held))

    def call(self, service, type, request=None, persistent=False, **_):
        cls = service_type(type)
        proxy = self.proxies.get(service) if persistent else None
        if proxy is None:
            proxy = rospy.ServiceProxy(service, cls, persistent=persistent)
        if persistent:
            self.proxies[service] = proxy
        filled = fill(cls._request_class(), request or {})
        return self.add(Calling(lambda: to_plain(proxy.call(filled))))

    def act(self, **params):
        return self.add(Acting(params, fill, to_plain))

    def send_goal(self, action, type, goal=None, seconds=40.0, **_):
        if (action, type) not in self.action_clients:
            self.action_clients[action, type] = action_client(action, type)
        client = self.action_clients[action, type]
        assert client.wait_for_server(rospy.Duration(seconds)), f"no server of {action}"
        return self.add(Goal(client, fill(message_class(type + "Goal")(), goal or {}), to_plain))

    def await_service(self, service, seconds=40.0):
        rospy.wait_for_service(service, seconds)
        return {}

    def connections(self, id):
        return {"count": self.parts[id].get_num_connections()}

    def graph(self):
        master = rosgraph.Master(rospy.get_name())
        publishers, subscribers, _ = master.getSystemState()
        types = {}
        for topic, name in master.getTopicTypes():
            types.setdefault(topic, []).append(name)
        return {"topics": types, "publishers": dict(publishers), "subscriptions": dict(subscribers)}

    def log(self, text):
        rospy.loginfo(text)
        return {}

    def set_param(self, name, value):
        rospy.set_param(name, value)
        return {}

    def get_param(self, name):
        return {"value": rospy.get_param(name, None)}

    def parameters(self):
        return {"names": rosgraph.Master(rospy.get_name()).getParamNames()}

    def now(self):
        return {"seconds": rospy.get_time()}


def main():
    answers = only_answers()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    rospy.init_node(sys.argv[1], disable_signals=True)
    try:
        serve(Peer(), answers)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # would end the clean-up, and leave registrations behind
        shut_down()


main()
