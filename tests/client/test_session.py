"""Clients of this machine's hub, and of other machines' hubs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.client.session import connect
from tests.peers.hub.rig import HubRig


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[HubRig]:
    rig = HubRig(tmp_path)
    yield rig
    rig.close()


@pytest.mark.parametrize("here", [True, False])
def test_a_client_detects_whether_its_hub_is_this_machines(rig: HubRig, here: bool) -> None:
    """Otherwise `bridge.client.status.daemon_names` would take another hub's daemons for this machine's."""
    with connect(rig.config(), here=here) as client:
        assert client.here is here
