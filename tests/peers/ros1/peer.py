"""The peer program of `tests.peers.peer` for ROS 1: a real rospy node on the system's Python with dist-packages only.

Beyond the common commands: ``define`` type, definition (full text: own fields, then each nested type's after a line of
``=`` and ``MSG: name``; a service's request and response with a line ``---`` between) makes a type known that is not
installed; ``advertise`` and ``subscribe`` take ``queue``
(rospy's queue_size); ``header`` id -> headers of the last message of each publisher; ``parameters`` -> names;
``now`` -> seconds: the node's time, 0 until /clock arrives;
``log`` text: to /rosout; ``await_service`` service, seconds: rospy's wait_for_service; ``count``, ``counted`` and
``tally``: see `tests.peers.peer`.

Messages are dicts of their fields; arrays of bytes are lists of integers, times are ``{"secs": .., "nsecs": ..}``.
Usage: peer.py NODE
"""
# ruff: noqa: A002, ANN003, ANN204  # parameters are the commands' own words; it runs without Midspan

import itertools
import json
import os
import signal
import sys
import threading
import time

import genpy
import genpy.message
import rosgraph
import rospy
from actions import Actions
from message_types import define, message_class, service_type
from shutdown import shut_down


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


class Subscriber:
    """A subscriber that stores all messages."""

    def __init__(self, topic, cls, queue):
        self.messages, self.times, self.headers, self.ready = [], [], {}, threading.Condition()
        self.endpoint = rospy.Subscriber(topic, cls, self.on_message, queue_size=queue, tcp_nodelay=True)

    def on_message(self, message):
        with self.ready:
            self.messages.append(message)
            self.times.append(time.monotonic())
            header = dict(message._connection_header)
            self.headers[header.get("callerid", "")] = header
            self.ready.notify_all()

    def wait(self, count, seconds, since):
        with self.ready:
            self.ready.wait_for(lambda: len(self.messages) >= count, seconds)
            return [to_plain(m) for m in self.messages[since:]]


class Serving:
    """A service with one answer to all requests."""

    def __init__(self, service, cls, reply, error, held):
        self.cls, self.reply, self.error = cls, reply, error
        self.requests, self.ready = [], threading.Condition()
        self.released = threading.Event()
        if not held:
            self.released.set()
        self.service = rospy.Service(service, cls, self.on_request)

    def on_request(self, request):
        with self.ready:
            self.requests.append(to_plain(request))
            self.ready.notify_all()
        self.released.wait()
        if self.error:
            raise rospy.ServiceException(self.error)
        return fill(self.cls._response_class(), self.reply)

    def wait(self, count, seconds):
        with self.ready:
            self.ready.wait_for(lambda: len(self.requests) >= count, seconds)
            return list(self.requests)

    def release(self):
        self.released.set()

    def unregister(self):
        self.released.set()
        self.service.shutdown("end of the test")


class Calling:
    """A service call on a thread."""

    def __init__(self, proxy, request):
        self.reply, self.error, self.at = None, "", 0.0
        self.thread = threading.Thread(target=self.run, args=(proxy, request), daemon=True)
        self.thread.start()

    def run(self, proxy, request):
        try:
            self.reply = to_plain(proxy.call(request))
        except Exception as err:
            self.error = str(err) or type(err).__name__
        self.at = time.monotonic()

    def result(self, seconds):
        self.thread.join(seconds)
        return {"done": not self.thread.is_alive(), "reply": self.reply, "error": self.error, "at": self.at}


class Counting:
    """Publishes numbers, one per message, on a thread."""

    def __init__(self, publish, first, count, rate):
        self.publish, self.sent, self.stopping = publish, 0, False
        self.thread = threading.Thread(target=self.run, args=(first, count, rate), daemon=True)
        self.thread.start()

    def run(self, first, count, rate):
        due = time.monotonic()
        while self.sent < count and not self.stopping:
            self.publish(str(first + self.sent))
            self.sent += 1
            due += 1.0 / rate
            time.sleep(max(0.0, due - time.monotonic()))

    def end(self, now):
        self.stopping = now
        self.thread.join()
        return {"sent": self.sent}


class Peer:
    """Executes the commands."""

    def __init__(self):
        self.endpoints, self.countings, self.proxies = {}, {}, {}
        self.next_id = 0
        self.actions = Actions(fill, to_plain)

    def add(self, endpoint):
        self.next_id += 1
        self.endpoints[self.next_id] = endpoint
        return {"id": self.next_id}

    def do_define(self, type, definition, **_):
        return {"md5": define(type, definition)._md5sum}

    def do_advertise(self, topic, type, latched=False, queue=100, **_):
        return self.add(rospy.Publisher(topic, message_class(type), latch=latched, queue_size=queue, tcp_nodelay=True))

    def do_publish(self, id, message, times=1, **_):
        publisher = self.endpoints[id]
        filled = fill(publisher.data_class(), message)
        for _ in range(times):
            publisher.publish(filled)
        return {}

    def do_subscribe(self, topic, type, queue=None, **_):
        cls = rospy.AnyMsg if type == "*" else message_class(type)
        return self.add(Subscriber(topic, cls, queue))

    def do_wait(self, id, count, seconds, since=0, **_):
        return {"messages": self.endpoints[id].wait(count, seconds, since)}

    def do_count(self, id, first, count, rate, **_):
        publisher = self.endpoints[id]
        self.countings[id] = Counting(lambda text: publisher.publish(data=text), first, count, rate)
        return {}

    def do_broadcast(self, id, child, rate, **_):
        publisher = self.endpoints[id]
        message = fill(message_class("tf2_msgs/TFMessage")(), {"transforms": [{"child_frame_id": child}]})

        def publish(_text) -> None:
            message.transforms[0].header = fill(message_class("std_msgs/Header")(), {"frame_id": "map"})
            message.transforms[0].header.stamp = rospy.Time.now()
            message.transforms[0].transform.rotation.w = 1.0
            publisher.publish(message)

        self.countings[id] = Counting(publish, 0, sys.maxsize, rate)
        return {}

    def do_counted(self, id, now=False, **_):
        return self.countings.pop(id).end(now)

    def do_tally(self, id, since=0.0, **_):
        with self.endpoints[id].ready:
            numbers = [int(m.data) for m in self.endpoints[id].messages]
        silence = self.do_silence(id, since)
        return {"received": len(numbers), "distinct": len(set(numbers)), **silence}

    def do_silence(self, id, since=0.0, **_):
        with self.endpoints[id].ready:
            times = list(self.endpoints[id].times)
        later = [since, *(t for t in times if t >= since)]
        silence = max((after - before for before, after in itertools.pairwise(later)), default=0.0)
        return {"last": times[-1] if times else 0.0, "silence": silence}

    def do_header(self, id, **_):
        return {"headers": self.endpoints[id].headers}

    def do_serve(self, service, type, reply=None, error="", held=False, **_):
        return self.add(Serving(service, service_type(type), reply or {}, error, held))

    def do_release(self, id, **_):
        self.endpoints[id].release()
        return {}

    def do_requests(self, id, count=1, seconds=40.0, **_):
        return {"requests": self.endpoints[id].wait(count, seconds)}

    def do_call(self, service, type, request=None, persistent=False, **_):
        cls = service_type(type)
        proxy = self.proxies.get(service) if persistent else None
        if proxy is None:
            proxy = rospy.ServiceProxy(service, cls, persistent=persistent)
        if persistent:
            self.proxies[service] = proxy
        return self.add(Calling(proxy, fill(cls._request_class(), request or {})))

    def do_result(self, id, seconds=40.0, **_):
        return self.endpoints[id].result(seconds)

    def do_act(self, **params):
        return self.add(self.actions.act(params))

    def do_goals(self, id, count=1, seconds=40.0, **_):
        return {"goals": self.endpoints[id].wait(count, seconds)}

    def do_send_goal(self, **params):
        return self.add(self.actions.send_goal(params))

    def do_goal(self, id, until=None, seconds=40.0, **_):
        return self.endpoints[id].wait(until or {}, seconds)

    def do_cancel(self, id, **_):
        self.endpoints[id].cancel()
        return {}

    def do_await_service(self, service, seconds=40.0, **_):
        rospy.wait_for_service(service, seconds)
        return {}

    def do_drop(self, id, **_):
        endpoint = self.endpoints.pop(id)
        getattr(endpoint, "endpoint", endpoint).unregister()
        return {}

    def do_connections(self, id, **_):
        endpoint = self.endpoints[id]
        return {"count": getattr(endpoint, "endpoint", endpoint).get_num_connections()}

    def do_graph(self, **_):
        master = rosgraph.Master(rospy.get_name())
        publishers, subscribers, _ = master.getSystemState()
        types = {}
        for topic, name in master.getTopicTypes():
            types.setdefault(topic, []).append(name)
        return {"topics": types, "publishers": dict(publishers), "subscriptions": dict(subscribers)}

    def do_log(self, text, **_):
        rospy.loginfo(text)
        return {}

    def do_set_param(self, name, value, **_):
        rospy.set_param(name, value)
        return {}

    def do_get_param(self, name, **_):
        return {"value": rospy.get_param(name, None)}

    def do_parameters(self, **_):
        return {"names": rosgraph.Master(rospy.get_name()).getParamNames()}

    def do_now(self, **_):
        return {"seconds": rospy.get_time()}

    def do_exit(self, **_):
        return {}


def main():
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # rospy's own output must not mix with the answers
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    rospy.init_node(sys.argv[1], disable_signals=True)
    try:
        serve(answers)
    finally:
        shut_down()


def serve(answers):
    """Execute commands until the input ends."""
    peer = Peer()
    for line in sys.stdin:
        command = json.loads(line)
        name = command.pop("do")
        try:
            answer = {"ok": True, **getattr(peer, "do_" + name)(**command)}
        except Exception as err:
            answer = {"ok": False, "error": f"{type(err).__name__}: {err}"}
        answers.write(json.dumps(answer) + "\n")
        if name == "exit":
            break


main()
