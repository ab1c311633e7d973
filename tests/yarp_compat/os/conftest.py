"""Networks for the tests of YARP's os classes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import yarp_compat as yarp
from tests.support.ports import free_port
from yarp_compat.naming.server import NameServer
from yarp_compat.os.runtime import RUNTIME


@pytest.fixture
def local() -> Iterator[None]:
    """Register names only in this process."""
    yarp.Network.setLocalMode(True)
    yarp.Network.init()
    yield
    yarp.Network.fini()
    yarp.Network.setLocalMode(False)
    assert not RUNTIME.is_up


@pytest.fixture
def name_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[NameServer]:
    """Midspan's name server, at the address in yarp.conf."""
    with NameServer(port=free_port()) as server:
        monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
        monkeypatch.delenv("YARP_NAMESPACE", raising=False)
        (tmp_path / "yarp.conf").write_text(f"{server.address.host} {server.address.port} yarp\n")
        yarp.Network.init()
        yield server
        yarp.Network.fini()
