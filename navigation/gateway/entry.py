"""The gateway's action on the hub, which it leaves to another node that serves the same name."""

from __future__ import annotations

from collections.abc import Callable

from bridge.config.sections.navigation import ACTION
from bridge.hub.graph.endpoints import HubEndpoint
from bridge.messages.actions import names
from bridge.modules.action_server import ActionServer, Goal
from bridge.modules.host import Host
from navigation.goals import FarClients
from navigation.messages import NAVIGATE

STOP_SERVICE = "/navigation/stop"
"""Every gateway serves this service, so that gateways recognize each other."""

_POLL_SECONDS = 0.2


class NavigateAction:
    """Serves ``/navigate_to_pose`` unless another node does, such as Nav2 on rmw_zenoh: only one node executes a goal.

    While another node announces the action, or the planner has it, the gateway accepts no goals there; its active goals
    continue.

    Args:
        planner_has_it: whether the planner itself serves the action, now or as soon as it is started.
        accept: see `bridge.modules.action_server.Accept`; cancel: the same for a cancellation.
        client_lost: called with a goal whose client is unreachable, and the reason.
    """

    def __init__(
        self,
        host: Host,
        planner_has_it: Callable[[], bool],
        accept: Callable[[Goal], bool],
        cancel: Callable[[Goal], bool],
        client_lost: Callable[[Goal, str], None],
    ) -> None:
        self._host, self._planner_has_it = host, planner_has_it
        self._accept, self._cancel, self._client_lost = accept, cancel, client_lost
        self._server: ActionServer | None = None
        self._watch: FarClients | None = None
        self.served_by = ""  # the node that serves the action instead; "" if the gateway does
        self._seen = ""  # the node that the last poll found
        self.poll()
        host.loop.every(_POLL_SECONDS, self.poll)

    def poll(self) -> None:
        """Leave the name to another node, or take it back."""
        if self._planner_has_it():
            self.served_by = self._seen = ""
            self._step_aside()
            return
        other = self._other_server()
        if other is None:
            if self.served_by:
                self._host.log.info("%s: %s has left; the gateway serves it again", ACTION, self.served_by)
            self.served_by = self._seen = ""
            self._serve()
            return
        node = f"{other.namespace.rstrip('/')}/{other.node.lstrip('/')}"
        before, self._seen = self._seen, node
        if node != before:
            return  # its other services, by which a gateway is recognized, may not be known yet
        if node != self.served_by:
            self._host.log.warning("%s is served by %s: the gateway accepts no goals under that name", ACTION, node)
        self.served_by = node
        self._step_aside()

    def planner_receives(self, topic: str) -> bool:
        """Return whether a planner that has the action subscribes to this topic of the hub itself."""
        if not self._planner_has_it():
            return False
        graph = self._host.node.hub.graph
        servers = {server.zid for server in graph.servers(names(ACTION).send_goal)}
        return any(not subscription.own and subscription.zid in servers for subscription in graph.subscriptions(topic))

    def _other_server(self) -> HubEndpoint | None:
        graph = self._host.node.hub.graph
        gateways = {server.zid for server in graph.servers(STOP_SERVICE)}
        servers = graph.servers(names(ACTION).send_goal)
        return next((server for server in servers if not server.own and server.zid not in gateways), None)

    def _serve(self) -> None:
        if self._server is not None and self._server.accepting:
            return
        if self._server is not None:
            if self._server.active:
                return  # its goals must end first
            self._close()
        self._server = self._host.node.action_server(ACTION, NAVIGATE, self._accept, self._cancel)
        self._watch = FarClients(self._host, self._server, self._client_lost)

    def _step_aside(self) -> None:
        if self._server is None:
            return
        self._server.stop_accepting()
        if not self._server.active:
            self._close()

    def _close(self) -> None:
        server, self._server = self._server, None
        watch, self._watch = self._watch, None
        if watch is not None:
            watch.close()
        if server is not None:
            server.close()
