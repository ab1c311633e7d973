"""Memory of large messages is returned, and the limit of open files is raised as far as the system permits."""

from __future__ import annotations

import errno
import os

import pytest

from bridge import resources


def test_memory_is_given_back_once_large_messages_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = resources.LargeMessages()
    watched.passed(1000)
    monkeypatch.setattr(resources, "_IDLE_SECONDS", 0.0)
    assert not watched.trim(), "small messages leave no memory to return"
    watched.passed(50_000_000)
    monkeypatch.setattr(resources, "_IDLE_SECONDS", 1000.0)
    assert not watched.trim(), "memory is kept, because the next large message may arrive soon"
    monkeypatch.setattr(resources, "_IDLE_SECONDS", 0.0)
    assert watched.trim()
    assert not watched.trim(), "memory is returned only once"


@pytest.mark.parametrize(("most", "raised"), [(1 << 20, 1 << 16), (10240, 10240), (256, 256)])
def test_open_files_are_raised_as_far_as_the_system_permits(
    most: int, raised: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A process on macOS starts with 256; the hard limit is infinite, but more than 10240 may be refused."""
    resource = pytest.importorskip("resource", reason="Windows has no limits")

    def set_limit(_: int, limits: tuple[int, int]) -> None:
        if limits[0] > most:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    monkeypatch.setattr(resource, "getrlimit", lambda _: (256, resource.RLIM_INFINITY))
    monkeypatch.setattr(resource, "setrlimit", set_limit)
    assert resources.raise_open_files() == raised
    assert ("remains at 256: [Errno 22]" in caplog.text) == (raised == 256)
