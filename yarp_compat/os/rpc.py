"""``RpcServer`` and ``RpcClient``: ports for questions and answers."""

from __future__ import annotations

import logging
from typing import Any

from yarp_compat.os.port import Port

log = logging.getLogger("yarp.os.Rpc")


class RpcServer(Port):
    """A port that answers: ``read(command, True)`` and then ``reply(answer)``, or a `PortReader`."""

    def __init__(self) -> None:
        super().__init__()
        self.setRpcServer()

    def read(self, data: Any, willReply: bool = True) -> bool:
        """Wait for a command; `reply` must follow."""
        if not willReply:
            log.error("%s must reply, please use a regular Port if you do not want to", self.getName())
            return False
        return super().read(data, True)

    def write(self, data: Any, reply: Any = None, callback: Any = None) -> bool:
        """Refuse: a server does not ask."""
        del data, reply, callback
        log.error("%s cannot write, please use a regular Port or RpcClient for that", self.getName())
        return False


class RpcClient(Port):
    """A port that asks: ``write(command, answer)``. It has one connection."""

    def __init__(self) -> None:
        super().__init__()
        self.setRpcClient()

    def read(self, data: Any, willReply: bool = False) -> bool:
        """Refuse: a client is not asked."""
        del data, willReply
        log.error("cannot read from RpcClient %s, please use a regular Port for that", self.getName())
        return False

    def reply(self, data: Any) -> bool:
        """Refuse: a client has nothing to answer."""
        del data
        return False

    replyAndDrop = reply
