"""The actions of one ROS 1 adapter: discovers and calls ROS 1 actions, and serves the hub's actions."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from dataclasses import replace

from bridge.adapters.ros1.actions import discovery
from bridge.adapters.ros1.actions.caller import ActionCaller, PartCaller, endpoint_id
from bridge.adapters.ros1.actions.discovery import NOTHING, FoundServer
from bridge.adapters.ros1.actions.frames import FrameGuard
from bridge.adapters.ros1.actions.network import (
    ActionMessages,
    ActionNetwork,
    LingeringPublishers,
    OpenPart,
    learn,
    types_of,
)
from bridge.adapters.ros1.actions.orphans import OrphanedGoals
from bridge.adapters.ros1.actions.served import PartPublisher, ServedAction
from bridge.adapters.ros1.graph.probe import Facts
from bridge.adapters.ros1.graph.state import MasterState, Registration
from bridge.hub.endpoints.calls import Call
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages import actions as ros2_action
from bridge.messages.errors import MessageTypeError
from bridge.routing.edge import Deliver, Endpoint, Kind, MadeBy

TICK_SECONDS = 0.1


class Ros1Actions:
    """Presents actionlib servers as ROS 2 actions, and ROS 2 actions as actionlib servers."""

    def __init__(self, network: ActionNetwork) -> None:
        self._network = network
        self._guard = FrameGuard(network)
        self._publishers = LingeringPublishers(network.publish, lambda name: not self._natives(name, network.facts()))
        self._toward_servers = replace(network, publish=self._publishers.publish)
        self._found = NOTHING
        self._lock = threading.Lock()
        self._callers: dict[tuple[str, str], ActionCaller] = {}
        self._served: dict[str, ServedAction] = {}
        self._orphans = OrphanedGoals()
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

    def stop(self) -> None:
        """Stop the thread; the engine has already closed all endpoints."""
        self._stopping.set()
        thread = self._thread  # the thread exits by itself if nothing is open
        if thread is not None and thread is not threading.current_thread():
            thread.join(1.0)
        self._publishers.close()

    def on_master_changed(self, state: MasterState | None) -> None:
        """Adopt a changed state of the master."""
        self._found = discovery.find(state, self._network.own()) if state is not None else NOTHING
        self._guard.seen(state)

    def on_master_read(self) -> None:
        """Do periodic work after each read of the master, changed or not."""
        self._publishers.tidy()

    def expects_server(self, topic: str) -> bool:
        """Return whether a new subscriber of this topic may be an action server that is now complete."""
        return topic in self._publishers

    def names(self) -> set[str]:
        """Return the names of all parts of discovered actions."""
        return {ros2_action.part_name(name, p) for name in self._found.servers for p in ros2_action.PARTS}

    def is_part(self, topic: str, type_name: str) -> bool:
        """Return whether a topic belongs to an action, and therefore is not bridged as a topic.

        An action that is served or called here counts even while a node has registered only some of its topics. A
        second subscription would lose messages, because a rospy publisher accepts one connection from each node.
        """
        wanted = self._found.topics.get(topic) or self._topics_in_use(topic.rpartition("/")[0]).get(topic)
        return wanted is not None and type_name in ("", "*", wanted)

    def _topics_in_use(self, action: str) -> Mapping[str, str]:
        """Return the topics of an action that is served or called here, with their types."""
        served = self._served.get(action)
        types = [served.type] if served is not None else [t for name, t in list(self._callers) if name == action]
        return discovery.topics_of(action, types[-1]) if types and types[-1] else {}

    def endpoints(self) -> Iterator[Endpoint]:
        """Yield the other nodes' actionlib servers as the parts of ROS 2 actions."""
        facts = self._network.facts()
        for servers in self._found.servers.values():
            for server in servers:
                native = discovery.is_native(server, facts)
                made_by = MadeBy.UNKNOWN if native is None else MadeBy.NATIVE if native else MadeBy.MIDSPAN
                for part in ros2_action.PARTS:
                    yield _endpoint(server, part, made_by)

    def learn(self, name: str) -> None:
        """Learn the types of a part's action from the connection headers of the action's publishers."""
        action = name.rpartition("/_action/")[0]
        servers = self._found.servers.get(action)
        if servers:
            learn(self._network, discovery.topics_of(action, servers[0].type))

    def warnings(self) -> list[str]:
        """Return the actions that cannot be offered on ROS 1, and the recently rejected goals."""
        rivals = [
            f"{s.name}: {s.rival} serves this action on ROS 1 itself, so the hub's action is not offered there"
            for s in list(self._served.values())
            if s.rival
        ]
        return [*rivals, *self._guard.warnings()]

    def caller(self, action: str, part: str, type_name: str) -> PartCaller:
        """Return a client of one service of an actionlib server; raises `MessageTypeError`."""
        type_ = self._type(action, part, type_name)
        with self._lock:
            return self._caller(action, type_).caller(part)

    def subscribe(self, action: str, part: str, type_name: str, deliver: Deliver) -> OpenPart:
        """Subscribe to one topic of an actionlib server; raises `MessageTypeError`."""
        type_ = self._type(action, part, type_name)
        with self._lock:
            return self._caller(action, type_).subscribe(part, deliver)

    def serve(self, action: str, part: str, type_name: str, call: Call) -> OpenPart:
        """Serve one of the services of an action; raises `MessageTypeError`."""
        with self._lock:
            return self._serve(action).serve(part, type_name, call)

    def advertise(self, action: str, part: str) -> PartPublisher:
        """Publish one of the topics of an action."""
        with self._lock:
            return self._serve(action).advertise(part)

    def _type(self, action: str, part: str, type_name: str) -> str:
        """Return the action's type; cancel_goal and status do not show it, so it then comes from a server or caller."""
        if part not in (ros2_action.CANCEL_GOAL, ros2_action.STATUS):
            return discovery.action_type(type_name, part)
        servers = self._found.servers.get(action)
        if servers:
            return servers[0].type
        open_ = [type_ for name, type_ in self._callers if name == action]
        if open_:
            return open_[-1]
        raise MessageTypeError(f"no actionlib server of {action} was found")

    def _types(self, type_: str) -> ActionMessages:
        return types_of(self._network.registry, type_)

    def _caller(self, action: str, type_: str) -> ActionCaller:
        caller = self._callers.get((action, type_))
        if caller is None:
            caller = ActionCaller(
                action, self._types(type_), self._toward_servers, self._guard,
                lambda server: server in self._natives(action, self._network.facts()),
            )  # fmt: skip
            self._callers[action, type_] = caller
        self._start_thread()
        return caller

    def _serve(self, action: str) -> ServedAction:
        served = self._served.get(action)
        if served is None:
            served = self._served[action] = ServedAction(action, self._network, self._types, self._orphans)
        self._start_thread()
        return served

    def _start_thread(self) -> None:
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
        for action in served:
            action.poll(next((s.node for s in self._natives(action.name, facts)), ""))

    def _natives(self, name: str, facts: Mapping[Registration, Facts]) -> list[FoundServer]:
        return [s for s in self._found.servers.get(name, ()) if discovery.is_native(s, facts)]


def _endpoint(server: FoundServer, part: str, made_by: MadeBy) -> Endpoint:
    return Endpoint(
        endpoint_id(server, part),
        Kind.SERVER if part in ros2_action.SERVICES else Kind.PUBLISHER,
        ros2_action.part_name(server.name, part),
        discovery.part_type(server.type, part),
        LATCHED if part == ros2_action.STATUS else Qos(),
        made_by,
        server.node,
    )
