"""Sessions open even if shared memory is full or refused."""

from __future__ import annotations

import ctypes
import json
import logging
import shutil
import subprocess
import sys

import pytest
import zenoh

from bridge.hub import opening
from bridge.hub.opening import lock_trouble, open_session
from bridge.hub.zenoh_config import client_session_config, make_config, session_tree
from tests.peers.hub.network import ROOT
from tests.support.ports import free_port

SWITCH = "transport/shared_memory/enabled"
SEGMENT = "Unable to create POSIX shm segment: OS error 12 at /zenoh/segment.rs:85."


def config(*, shared_memory: bool = True) -> zenoh.Config:
    return make_config(session_tree(None, shared_memory=shared_memory, max_payload=1 << 20), None)


class Opened:
    """A stand-in for `zenoh.open` that refuses shared memory with a reason."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        self.switches: list[bool] = []

    def __call__(self, settings: zenoh.Config) -> Opened:
        self.switches.append(json.loads(settings.get_json(SWITCH)))
        if self.reason and self.switches[-1]:
            raise zenoh.ZError(self.reason)
        return self

    def declare_keyexpr(self, _key: str) -> None:
        """Fail as a closed session, because `panics` would otherwise keep it for the tests after this one."""
        raise zenoh.ZError("session closed")


@pytest.fixture(autouse=True)
def _fresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "_trouble", "")
    monkeypatch.setattr(opening, "_noted", False)
    monkeypatch.setattr(opening, "lock_trouble", lambda _size: "")
    monkeypatch.setattr(opening, "room_trouble", lambda _size: "")


def opened(monkeypatch: pytest.MonkeyPatch, reason: str = "") -> Opened:
    stand_in = Opened(reason)
    monkeypatch.setattr(zenoh, "open", stand_in)
    return stand_in


def logged(caplog: pytest.LogCaptureFixture) -> list[logging.LogRecord]:
    """Return the records of this module; threads of earlier tests may still log."""
    return [record for record in caplog.records if record.name == opening.__name__]


def test_session_opens_without_a_refused_segment(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    zenoh_open = opened(monkeypatch, SEGMENT)
    with caplog.at_level(logging.WARNING):
        open_session(config())
        open_session(config())
    assert zenoh_open.switches == [True, False] * 2
    (record,) = logged(caplog)
    assert record.getMessage() == opening.trouble()
    assert "large messages go over the network link" in record.getMessage()
    assert "Unable to create POSIX shm segment: OS error 12" in record.getMessage()
    assert "segment.rs" not in record.getMessage()


def test_session_without_room_skips_shared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "room_trouble", lambda _size: "/dev/shm is full")
    zenoh_open = opened(monkeypatch)
    open_session(config())
    assert zenoh_open.switches == [False]
    assert "/dev/shm is full" in opening.trouble()


def test_a_limit_of_locked_memory_is_logged_but_no_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(opening, "lock_trouble", lambda _size: "this user may lock 8.4 MB of memory")
    zenoh_open = opened(monkeypatch)
    with caplog.at_level(logging.INFO):
        open_session(config())
    assert zenoh_open.switches == [False]
    assert [record.levelname for record in logged(caplog)] == ["INFO"]
    assert "this user may lock 8.4 MB of memory; then restart this worker ('kill PID' with the pid in" in caplog.text
    assert opening.trouble() == ""


def test_another_error_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    zenoh_open = opened(monkeypatch, "Unable to connect to any of [tcp/127.0.0.1:1]")
    with pytest.raises(zenoh.ZError, match="Unable to connect"):
        open_session(config())
    assert zenoh_open.switches == [True]
    assert opening.trouble() == ""


def test_session_without_shared_memory_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opening, "room_trouble", lambda _size: "full")
    zenoh_open = opened(monkeypatch)
    open_session(config(shared_memory=False))
    assert zenoh_open.switches == [False]
    assert opening.trouble() == ""


@pytest.mark.skipif(sys.platform != "linux", reason="the limit of Linux")
def test_a_limit_of_locked_memory_is_reported_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    import resource

    limit = 8 << 20
    monkeypatch.setattr(resource, "getrlimit", lambda _which: (limit, limit))

    class Libc:
        def mlock2(self, _address: object, size: ctypes.c_size_t, _flags: int) -> int:
            return -1 if size.value > limit else 0

    monkeypatch.setattr(ctypes, "CDLL", lambda *_args, **_more: Libc())
    assert "may lock 8.4 MB of memory, and a process that receives from 16 sessions locks" in lock_trouble(18 << 20)
    assert "locks up to 302 MB; set LimitMEMLOCK" in lock_trouble(18 << 20)
    limit = 64 << 20  # only three pools
    assert "may lock 67.1 MB" in lock_trouble(18 << 20)
    limit = resource.RLIM_INFINITY
    assert lock_trouble(18 << 20) == ""


def test_a_commands_session_never_uses_shared_memory() -> None:
    user = {"transport": {"shared_memory": {"enabled": True}}}
    assert json.loads(client_session_config("tcp/127.0.0.1:1", user, 1.0).get_json(SWITCH)) is False


PROGRAM = """
import json, os, sys, threading
from bridge.hub import opening
from bridge.hub.opening import check_pool, open_session, prepare_to_send, trouble
from bridge.hub.zenoh_config import make_config, session_tree

case, prepares, endpoint = sys.argv[1], sys.argv[2] == "prepares", sys.argv[3]

def fill(left):
    with open("/dev/shm/fill", "ab", 0) as file:
        try:
            while (room := os.statvfs("/dev/shm")).f_bavail * room.f_frsize > left:
                file.write(bytes(4096))
        except OSError:
            pass

def join(key):
    config = make_config(session_tree(None, shared_memory=True, max_payload=1 << 28), None)
    config.insert_json5(f"{key}/endpoints", json.dumps([endpoint]))
    return open_session(config, prepares=prepares)

if case == "full":
    fill(0)
sender, receiver, arrived = join("listen"), join("connect"), threading.Semaphore(0)
receiver.declare_subscriber("large", lambda sample: arrived.release() if len(sample.payload.to_bytes()) else None)
publisher = sender.declare_publisher("large")
if case == "filled later":
    fill(17_000_000)  # room for a pool, and none for its book-keeping
if case == "filled before the pool":
    fill(1_000_000)
if case == "filled before anything":
    fill(0)
received = 0
for _ in range(200):
    if prepares:
        prepare_to_send(1_000_000)
    publisher.put(bytes(1_000_000))
    received += arrived.acquire(timeout=0.1)
    if received == 20:  # zenoh creates its pool while it sends the first ones
        break
opening._CHECK_SECONDS = 0.0
for _ in range(3):
    check_pool()
print(json.dumps([received, trouble()]), flush=True)
sender.close(), receiver.close()
"""


@pytest.mark.parametrize(
    ("case", "how", "trouble"),
    [
        ("full", "prepares", "/dev/shm has less room"),
        ("filled later", "at once", ""),
        ("filled later", "prepares", "/dev/shm had no room for the 17 MB"),
        ("filled before the pool", "at once", "/dev/shm had no room for the 17 MB"),
        ("filled before anything", "prepares", "OS error 12"),
        ("plenty of room", "prepares", ""),
    ],
)
def test_large_messages_arrive_with_a_full_folder(case: str, how: str, trouble: str) -> None:
    """The pool's metadata is created when the session opens (``at once``) or before the first large message."""
    if not shutil.which("unshare"):
        pytest.skip("needs unshare")
    mount = 'mount -t tmpfs -o size=40m tmpfs /dev/shm || exit 97; exec "$@"'
    program = [sys.executable, "-c", PROGRAM, case, how, f"tcp/127.0.0.1:{free_port()}"]
    ended = subprocess.run(
        ["unshare", "--mount", "sh", "-c", mount, "sh", *program],
        cwd=ROOT, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    if ended.returncode in (1, 97) and not ended.stdout and "Traceback" not in ended.stderr:
        pytest.skip("may not mount a separate /dev/shm")
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr.count("large messages go over the network link") == bool(trouble), "the warning is logged once"
    received, warning = json.loads(ended.stdout.splitlines()[-1])
    assert received == 20
    assert bool(warning) == bool(trouble)
    assert trouble in warning
