"""Runs only the hub's router, with a configuration in JSON, until SIGTERM.

Midspan's sessions restore lost links with the help of the router of their own domain. With ``--every-domain``, the
router helps the sessions of all domains, because tests that share a router change the domain.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
from typing import Any

import zenoh

from bridge.config.model import Config
from bridge.hub.control import Control
from bridge.hub.links import MEMBERS
from bridge.hub.rejoin import REJOIN, Rejoins
from bridge.hub.router import RouterWorker


def help_every_domain(session: zenoh.Session) -> Control:
    """Answer the requests for the router's sessions in all domains but the router's own."""

    def members(_params: dict[str, Any]) -> dict[str, Any]:
        transports = session.info.transports()
        peers = [str(transport.zid) for transport in transports if transport.whatami == zenoh.WhatAmI.PEER]
        return {"zid": str(session.zid()), "members": [str(transport.zid) for transport in transports], "peers": peers}

    domains: Any = "*"
    control = Control(session, domains, "test", "router")
    control.serve(MEMBERS, members)
    control.serve(REJOIN, Rejoins(session).answer)
    return control


stop = threading.Event()
signal.signal(signal.SIGTERM, lambda _number, _frame: stop.set())
worker = RouterWorker()
worker.start(Config.model_validate(json.loads(sys.argv[1])))
control = None
try:
    if sys.argv[2:]:
        assert worker._session is not None
        control = help_every_domain(worker._session)
    print("listening", flush=True)
    while not stop.wait(0.2):
        pass
finally:
    if control is not None:
        control.close()
    worker.stop()
