"""The actions of one ROS 1 edge: which there are, calling them, and serving those of the hub."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping

from bridge.adapters.base import Deliver, Endpoint, Kind, MadeBy
from bridge.adapters.ros1.actions import finding, parts
from bridge.adapters.ros1.actions.caller import ActionCaller, PartCaller, PartSubscription, endpoint_id
from bridge.adapters.ros1.actions.finding import NOTHING, Server
from bridge.adapters.ros1.actions.guard import FrameGuard
from bridge.adapters.ros1.actions.network import ActionTypes, Network, learn, types_of
from bridge.adapters.ros1.actions.served import PartPublisher, PartServer, ServedAction
from bridge.adapters.ros1.graph import Link, Look
from bridge.adapters.ros1.probe import Facts
from bridge.hub.call import Call
from bridge.hub.qos import Durability, Qos
from bridge.messages.errors import MessageTypeError

TICK_SECONDS = 0.1

_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)


class Actions:
    """Shows actionlib servers as ROS 2's actions, and ROS 2's actions as actionlib servers."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._guard = FrameGuard(network)
        self._found = NOTHING
        self._lock = threading.Lock()
        self._callers: dict[tuple[str, str], ActionCaller] = {}
        self._served: dict[str, ServedAction] = {}
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

    def stop(self) -> None:
        """Look after nothing any more; what is open was closed by who opened it."""
        self._stopping.set()
        thread = self._thread  # it ends by itself where nothing is open any more
        if thread is not None and thread is not threading.current_thread():
            thread.join(1.0)

    # -- the graph -----------------------------------------------------------------------------------------------------

    def seen(self, look: Look | None) -> None:
        """One look at the master that differs from the last."""
        self._found = finding.find(look, self._network.own()) if look is not None else NOTHING
        self._guard.seen(look)

    def names(self) -> set[str]:
        """The names of all parts."""
        return {parts.name_of(name, p) for name in self._found.servers for p in (*parts.SERVICES, *parts.TOPICS)}

    def is_part(self, topic: str, type_name: str) -> bool:
        """Whether a topic is one of an action's five, and so does not cross as a topic.

        Those that are served or called here are that too while a node has registered only some of them: a topic heard
        twice costs messages, since a publisher of rospy's keeps one connection from each node.
        """
        wanted = self._found.topics.get(topic) or self._in_use(topic.rpartition("/")[0]).get(topic)
        return wanted is not None and type_name in ("", "*", wanted)

    def _in_use(self, action: str) -> Mapping[str, str]:
        """The topics of an action that is served or called here, and their types."""
        served = self._served.get(action)
        types = [served.type] if served is not None else [t for name, t in list(self._callers) if name == action]
        return finding.topics_of(action, types[-1]) if types and types[-1] else {}

    def endpoints(self) -> Iterator[Endpoint]:
        """The other nodes' actionlib servers, each as ROS 2 has it."""
        facts = self._network.facts()
        for servers in self._found.servers.values():
            for server in servers:
                native = finding.is_native(server, facts)
                made_by = MadeBy.UNKNOWN if native is None else MadeBy.NATIVE if native else MadeBy.MIDSPAN
                for part in (*parts.SERVICES, *parts.TOPICS):
                    yield _endpoint(server, part, made_by)

    def learn(self, name: str) -> None:
        """Take up what is told on the graph of the types of the action that a part belongs to."""
        action = name.rpartition("/_action/")[0]
        servers = self._found.servers.get(action)
        if servers:
            learn(self._network, finding.topics_of(action, servers[0].type))

    def warnings(self) -> list[str]:
        """What a person should know."""
        held = [
            f"{s.name}: {s.rival} serves this action on ROS 1 itself, so the hub's is not offered there"
            for s in list(self._served.values())
            if s.rival
        ]
        return [*held, *self._guard.warnings()]

    # -- the parts of actions ------------------------------------------------------------------------------------------

    def caller(self, action: str, part: str, type_name: str) -> PartCaller:
        """One of the services of an actionlib server; raises `MessageTypeError`."""
        type_ = self._type(action, part, type_name)
        with self._lock:
            return self._caller(action, type_).caller(part)

    def subscribe(self, action: str, part: str, type_name: str, deliver: Deliver) -> PartSubscription:
        """One of the topics of an actionlib server; raises `MessageTypeError`."""
        type_ = self._type(action, part, type_name)
        with self._lock:
            return self._caller(action, type_).subscribe(part, deliver)

    def serve(self, action: str, part: str, type_name: str, call: Call) -> PartServer:
        """Serve one of the services of an action; raises `MessageTypeError`."""
        with self._lock:
            return self._serve(action).serve(part, type_name, call)

    def advertise(self, action: str, part: str) -> PartPublisher:
        """Publish one of the topics of an action."""
        with self._lock:
            return self._serve(action).advertise(part)

    def _type(self, action: str, part: str, type_name: str) -> str:
        """The action's type; that of two parts says nothing of it."""
        if part not in (parts.CANCEL_GOAL, parts.STATUS):
            return parts.action_type(type_name, part)
        servers = self._found.servers.get(action)
        if servers:
            return servers[0].type
        open_ = [type_ for name, type_ in self._callers if name == action]
        if open_:
            return open_[-1]
        msg = f"there is no actionlib server {action}"
        raise MessageTypeError(msg)

    def _types(self, type_: str) -> ActionTypes:
        return types_of(self._network.registry, type_)

    def _caller(self, action: str, type_: str) -> ActionCaller:
        caller = self._callers.get((action, type_))
        if caller is None:
            caller = ActionCaller(action, self._types(type_), self._network, self._guard)
            self._callers[action, type_] = caller
        self._look_after()
        return caller

    def _serve(self, action: str) -> ServedAction:
        served = self._served.get(action)
        if served is None:
            served = self._served[action] = ServedAction(action, self._network, self._types)
        self._look_after()
        return served

    # -- time ----------------------------------------------------------------------------------------------------------

    def _look_after(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="midspan-ros1-actions", daemon=True)
            self._thread.start()

    def _run(self) -> None:
        while not self._stopping.wait(TICK_SECONDS):
            with self._lock:
                callers, served = list(self._callers.values()), list(self._served.values())
            self._tick(callers, served)
            with self._lock:
                self._callers = {k: c for k, c in self._callers.items() if c.in_use}
                self._served = {k: s for k, s in self._served.items() if s.in_use}
                if not self._callers and not self._served:
                    self._thread = None
                    return

    def _tick(self, callers: list[ActionCaller], served: list[ServedAction]) -> None:
        facts = self._network.facts()
        for caller in callers:
            caller.poll(self._natives(caller.name, facts))
        for one in served:
            one.poll(next((s.node for s in self._natives(one.name, facts)), ""))

    def _natives(self, name: str, facts: Mapping[Link, Facts]) -> list[Server]:
        """The native servers of an action that have answered."""
        return [s for s in self._found.servers.get(name, ()) if finding.is_native(s, facts)]


def _endpoint(server: Server, part: str, made_by: MadeBy) -> Endpoint:
    return Endpoint(
        endpoint_id(server, part),
        Kind.SERVER if part in parts.SERVICES else Kind.PUBLISHER,
        parts.name_of(server.name, part),
        parts.type_of(server.type, part),
        _LATCHED if part == parts.STATUS else Qos(),
        made_by,
        server.node,
    )
