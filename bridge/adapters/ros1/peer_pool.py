"""Threads for requests to other nodes, so that dead and slow nodes do not delay the others."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable

from bridge.concurrency import WorkerPool

_log = logging.getLogger(__name__)

AT_ONCE = 2
"""Concurrent requests to one address. rospy's TCPROS server and roscpp's XML-RPC server have a backlog of five
connections (``listen(5)``). If there are more connections, some are dropped, including those of other nodes, and TCP
retries them a second later."""

Job = Callable[[], None]


class PeerPool:
    """Two pools of threads: one for addresses that responded or are new, one for addresses whose last request failed.

    A job whose address has failed since it was queued changes pools, so that dead nodes delay only each other.
    """

    def __init__(self, fresh: int = 48, doubtful: int = 4) -> None:
        self._fresh = WorkerPool(fresh, "midspan-ros1-fresh")
        self._doubtful = WorkerPool(doubtful, "midspan-ros1-doubtful")
        self._lock = threading.Lock()
        self._peers: dict[str, _PeerJobs] = {}
        self._failed_addresses: set[str] = set()

    def submit(self, address: str, job: Job) -> None:
        """Schedule a job that calls ``address``."""
        with self._lock:
            peer = self._peers.setdefault(address, _PeerJobs())
            peer.jobs.append(job)
            if peer.running == AT_ONCE:
                return
            peer.running += 1
        self._start_next(address, peer)

    def resume(self) -> None:
        """Start the jobs for which the system had no threads left; called regularly."""
        with self._lock:
            waiting = [(address, peer) for address, peer in self._peers.items() if not peer.running]
            for _, peer in waiting:
                peer.running += 1
        for address, peer in waiting:
            self._start_next(address, peer)

    def _start_next(self, address: str, peer: _PeerJobs) -> None:
        if self._is_doubtful(address):
            started = self._doubtful.submit(lambda: self._run_next(address, peer))
        else:
            started = self._fresh.submit(
                lambda: self._start_next(address, peer) if self._is_doubtful(address) else self._run_next(address, peer)
            )
        if started.cancelled():
            with self._lock:
                peer.running -= 1

    def _run_next(self, address: str, peer: _PeerJobs) -> None:
        with self._lock:
            job = peer.jobs.popleft() if peer.jobs else lambda: None  # another thread took the job
        try:
            job()
        except Exception:
            _log.exception("a request to a ROS 1 node failed unexpectedly")
        finally:
            with self._lock:
                more = bool(peer.jobs)
                if not more:
                    peer.running -= 1
                if not peer.running:
                    del self._peers[address]
            if more:
                self._start_next(address, peer)

    def failed(self, address: str) -> None:
        """Mark an address as failed."""
        with self._lock:
            self._failed_addresses.add(address)

    def answered(self, address: str) -> None:
        """Mark an address as responsive."""
        with self._lock:
            self._failed_addresses.discard(address)

    def retain(self, alive: set[str]) -> None:
        """Drop the marks of addresses that left the graph."""
        with self._lock:
            self._failed_addresses &= alive

    def stop(self) -> None:
        """Start no further jobs; running jobs end by their own deadlines."""
        self._fresh.close()
        self._doubtful.close()

    def _is_doubtful(self, address: str) -> bool:
        with self._lock:
            return address in self._failed_addresses


class _PeerJobs:
    """The waiting jobs of one address, and the number of threads that run them."""

    def __init__(self) -> None:
        self.jobs: deque[Job] = deque()
        self.running = 0
