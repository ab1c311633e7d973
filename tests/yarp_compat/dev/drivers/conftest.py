"""A name server, and servers for devices."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from tests.yarp_compat.os.conftest import name_server
from yarp_compat.dev.server import ServiceServer
from yarp_compat.dev.service import Service
from yarp_compat.wire.generation import Generation, Generations

__all__ = ["name_server"]

Serve = Callable[..., ServiceServer]


@pytest.fixture
def serve(name_server: object) -> Iterator[Serve]:
    """Serve interfaces on ports as a given YARP release does."""
    with ExitStack() as servers:

        def start(name: str, service: Service, generation: Generation = Generation.YARP_4) -> ServiceServer:
            server = ServiceServer(name, service, generations=Generations(generation), profile=generation.profile)
            return servers.enter_context(server)

        yield start
