"""Midspan's node on the ROS 1 graph: rospy's slave API, TCPROS server and topic manager, without ``rospy.init_node``.

``init_node`` blocks until a master responds, registers while it holds the topic manager's lock, retries forever, never
registers again with a restarted master, and publishes the process's log on ``/rosout``. Here rospy's parts are
assembled without that: registrations are only recorded, and `bridge.adapters.ros1.graph.master` applies them to the
master. Like rospy, the node can exist only once per process.
"""

from __future__ import annotations

import contextlib
import logging
import resource
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import rospy
import rospy.impl.init
import rospy.impl.registration as registration
import rospy.impl.tcpros
import rospy.impl.tcpros_base
from rosgraph.xmlrpc import SilenceableXMLRPCRequestHandler, XmlRpcNode
from rospy.impl.masterslave import ROSHandler

from bridge.adapters.ros1.graph.presence import FIELD
from bridge.adapters.ros1.handshake import Header, encode, read_header
from bridge.adapters.ros1.services.server import ServiceServers
from bridge.adapters.ros1.topics.publisher import late_header
from bridge.adapters.ros1_peers import DeadlineSocket, Ros1Error
from bridge.concurrency import WorkerPool

_log = logging.getLogger(__name__)

_GREETING_SECONDS = 5.0
_MAX_GREETINGS = 64
_BACKLOG = 128
_ACCEPT_PAUSE = 0.5
_MAX_TURNED_AWAY = 1000

_MAX_REQUEST = 2**20
"""Size limit of requests in bytes; a master's list of a topic's publishers is a few kilobytes."""

Changed = Callable[[], None]


class _RequestHandler(SilenceableXMLRPCRequestHandler):  # type: ignore[misc]  # rosgraph has no types
    """rosgraph's request handler with a size limit; the original reads bodies of any length into memory."""

    def do_POST(self) -> None:  # noqa: N802 - the name is from http.server
        length = self.headers.get("Content-Length", "")
        if length.isascii() and length.isdigit() and int(length[:20]) <= _MAX_REQUEST:
            super().do_POST()
        else:
            self.close_connection = True
            self.send_error(413, f"a request may have at most {_MAX_REQUEST} bytes")


class _SlaveApi(ROSHandler):  # type: ignore[misc]  # rospy has no types
    """rospy's slave API, which reports the master's request to shut down."""

    def __init__(self, name: str, master_uri: str, notes: _RegistrationNotes, asked: Callable[[str], None]) -> None:
        super().__init__(name, master_uri)
        self.reg_man, self._asked_to_stop = notes, asked
        self.parameter_changed: Changed | None = None

    def paramUpdate(self, _caller_id: str, _key: str, _value: object) -> tuple[int, str, int]:  # noqa: N802 - ROS 1's
        """Handle the master's report of a changed parameter; its value is read again."""
        if self.parameter_changed is not None:
            self.parameter_changed()
        return 1, "", 0

    def shutdown(self, caller_id: str, msg: str = "") -> tuple[int, str, int]:
        """Handle a request to stop, from the master (another node took the name) or a user (rosnode kill)."""
        self._asked_to_stop(f"{caller_id} requested this node's shutdown" + (f": {msg}" if msg else ""))
        return 1, "shutdown", 0


class _RegistrationNotes(registration.RegistrationListener):  # type: ignore[misc]  # rospy has no types
    """Replaces rospy's registration manager: a change only wakes the thread that calls the master."""

    def __init__(self, changed: Changed) -> None:
        self._changed = changed
        self.removed: set[str] = set()
        """Topics whose publication ended, even if it has begun again."""

    def start(self, _uri: str, _master_uri: str) -> None:
        """Start to receive notifications; rospy calls it once its XML-RPC server listens."""
        registration.get_registration_listeners().add_listener(self)

    def is_registered(self) -> bool:
        """Return True, so that rospy continues."""
        return True

    def publisher_update(self, _topic: str, _uris: list[str]) -> None:
        """Handle the master's report of new publishers of a subscribed topic."""
        self._changed()

    def reg_added(self, _name: str, _type_or_uri: str, _kind: str) -> None:
        self._changed()

    def reg_removed(self, name: str, _type_or_uri: str, kind: str) -> None:
        if kind == registration.Registration.PUB:
            self.removed.add(name)
        self._changed()


class _TcprosServer(rospy.impl.tcpros_base.TCPServer):  # type: ignore[misc]  # rospy has no types
    """rospy's TCPROS server, which survives a temporary lack of descriptors."""

    def run(self) -> None:
        while not self.is_shutdown:
            try:
                sock, address = self.server_sock.accept()
            except OSError as err:
                if not self.is_shutdown:
                    _log.warning("a ROS 1 subscriber could not be accepted: %s", err)
                    time.sleep(_ACCEPT_PAUSE)
                continue
            self.inbound_handler(sock, address)


class Ros1Node:
    """The node and its registrations: ``uri`` (XML-RPC), ``port`` (TCPROS), ``address`` (of its services)."""

    def __init__(
        self, name: str, master_uri: str, changed: Changed, asked_to_stop: Callable[[str], None],
        visit: Callable[[DeadlineSocket, Header, str], str], servers: ServiceServers, heard: Callable[[str], None],
    ) -> None:  # fmt: skip
        if rospy.core.is_initialized():
            raise RuntimeError("rospy is already in use in this process: one ROS 1 edge per process")
        # rosgraph changes the class of all new loggers of the process; this restores it
        logging.setLoggerClass(logging.Logger)
        self._greetings = threading.BoundedSemaphore(_MAX_GREETINGS)
        self._greeters = WorkerPool(_MAX_GREETINGS, "midspan-ros1-greet")
        self._turned_away: dict[tuple[str, str], str] = {}
        self._visit, self._servers, self._heard = visit, servers, heard
        self.rename(name)
        self._start_server()
        self._notes = _RegistrationNotes(changed)
        self._handler = _SlaveApi(name, master_uri, self._notes, asked_to_stop)
        self._server = XmlRpcNode(0, self._handler)
        self._server.start()
        self.uri = self._await_uri()
        self._server.server.RequestHandlerClass = _RequestHandler
        rospy.core.set_node_uri(self.uri)
        rospy.rostime.set_rostime_initialized(True)
        rospy.core.set_initialized(True)

    @property
    def name(self) -> str:
        """The node's name."""
        return str(rospy.names.get_caller_id())

    @staticmethod
    def rename(name: str) -> None:
        """Change the name, while nothing is registered under the old one."""
        rospy.names._set_caller_id(name)

    @staticmethod
    def publications() -> dict[str, str]:
        """Return the published topics with their types."""
        topics = registration.get_topic_manager()
        with topics.lock:
            return dict(topics.get_publications())

    def take_removed(self) -> set[str]:
        """Return the topics whose publications ended since the last call, even if they began again at once."""
        removed, self._notes.removed = self._notes.removed, set()
        return removed

    @staticmethod
    def subscriptions() -> dict[str, str]:
        """Return the subscribed topics with their types."""
        topics = registration.get_topic_manager()
        with topics.lock:
            return dict(topics.get_subscriptions())

    @staticmethod
    def subscribers() -> frozenset[tuple[str, str]]:
        """Return the subscribers that are connected to published topics, by node and topic."""
        topics = registration.get_topic_manager()
        with topics.lock:
            publications = list(topics.pubs.values())
        return frozenset((t.endpoint_id, p.resolved_name) for p in publications for t in p.connections)

    def services(self) -> dict[str, str]:
        """Return the served services with their addresses."""
        return dict.fromkeys(self._servers.names(), self.address)

    @staticmethod
    def drop_dead_connections() -> None:
        """Let rospy close dead connections."""
        registration.get_topic_manager().check_all()

    def turned_away(self) -> dict[tuple[str, str], str]:
        """Return the subscribers, by topic and node, that use another definition of the type, with the reason."""
        return dict(self._turned_away)

    def hear_parameters(self, changed: Changed | None) -> None:
        """Set the callback for changes of subscribed parameters, which runs on a thread of rospy."""
        self._handler.parameter_changed = changed

    def stop(self) -> None:
        """Close everything; `Master` has unregistered it before."""
        registration.get_registration_listeners().clear()
        registration.get_topic_manager().close_all()
        rospy.core.signal_shutdown("midspan stops")
        self._server.shutdown("midspan stops")
        self._greeters.close()

    def _await_uri(self) -> str:
        end = time.monotonic() + 5.0
        while not self._server.uri:
            if time.monotonic() > end:
                raise RuntimeError(
                    "the node's XML-RPC server did not start: is ROS_IP or ROS_HOSTNAME an address of this machine?"
                )
            time.sleep(0.001)
        return str(self._server.uri)

    # -- inbound connections -------------------------------------------------------------------------------------------

    def _start_server(self) -> None:
        rospy.impl.tcpros.init_tcpros()
        self._tcpros = rospy.impl.tcpros_base._tcpros_server
        server = _TcprosServer(self._greet)
        server.server_sock.listen(_BACKLOG)
        self.port = int(server.port)
        self.address = f"rosrpc://{server.get_full_addr()[0]}:{self.port}"
        server.start()
        self._tcpros.tcp_ros_server = server

    def _greet(self, sock: socket.socket, address: Any) -> None:
        """Read each peer's header on a thread: rospy reads them in sequence, so a silent one would block."""
        if not self._greetings.acquire(blocking=False):
            sock.close()
            return
        self._greeters.submit(lambda: self._greeting(sock, address))

    def _greeting(self, plain: socket.socket, address: Any) -> None:
        sock = DeadlineSocket(fileno=plain.detach())
        try:
            sock.deadline = time.monotonic() + _GREETING_SECONDS
            error = self._admit(sock, address, read_header(sock))
            if error:
                sock.sendall(encode({"error": error}))
                sock.close()
        except (OSError, Ros1Error) as err:
            _log.debug("a peer at %s was rejected: %s", address, err)
            sock.close()
        except Exception:
            _log.exception("a peer at %s could not be admitted", address)
            sock.close()
        finally:
            self._greetings.release()

    def _admit(self, sock: DeadlineSocket, address: Any, header: dict[str, str]) -> str:
        """Pass the peer to rospy, to the services, or to the links between Midspan nodes; return "" or why not."""
        if FIELD in header:
            return self._visit(sock, header, self.uri)
        if "topic" in header:
            error = self._hand_over(sock, address, header)
            self._note_type(header, error)
            if not error:
                self._heard(header["topic"])
            return error
        if "service" in header:
            return self._servers.admit(sock, header)
        return "the header has neither a topic nor a service"

    def _hand_over(self, sock: DeadlineSocket, address: Any, header: Header) -> str:
        """Pass a subscriber to rospy, or dismiss one that is too late (`late_header`); return "" or why not."""
        error = str(self._tcpros.topic_connection_handler(sock, address, header) or "")
        farewell = late_header(header) if error else None
        if farewell is None:
            return error
        publication = registration.get_topic_manager().get_publisher_impl(header["topic"])
        if publication is not None and not publication.closed:  # published again meanwhile, or with another type
            return str(self._tcpros.topic_connection_handler(sock, address, header) or "")
        sock.sendall(encode(farewell))
        sock.close()
        return ""

    def _note_type(self, header: dict[str, str], error: str) -> None:
        """Record subscribers with another definition of the type, which at most their own node reports."""
        topic, node, md5 = header["topic"], header.get("callerid", ""), header.get("md5sum", "*")
        publication = registration.get_topic_manager().get_publisher_impl(topic)
        ours = getattr(publication, "data_class", None)
        self._turned_away.pop((topic, node), None)
        if error and ours is not None and md5 not in {"*", ours._md5sum} and len(self._turned_away) < _MAX_TURNED_AWAY:
            theirs = f"{header.get('type', ours._type)} with md5 {md5}"
            self._turned_away[topic, node] = (
                f"it requests {theirs}, Midspan publishes {ours._type} with md5 {ours._md5sum}"
            )


# -- file descriptors --------------------------------------------------------------------------------------------------


def raise_descriptor_limit() -> None:
    """Raise the soft limit, often 1,024, to the hard one, as each connection needs a descriptor."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
