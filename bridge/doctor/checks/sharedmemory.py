"""Shared memory: other users' Fast DDS, too little room, litter of dead processes."""

from __future__ import annotations

import os
from collections.abc import Sequence

from bridge.doctor.around import Around
from bridge.doctor.finding import Finding, fail, ok, skip, warn
from bridge.doctor.shmfiles import shared_files

SMALL_BYTES = 128 * 1024 * 1024
"""Fast DDS takes half a megabyte for a stock participant; Midspan's wants an eighth of what is free, up to 64 MiB."""
FULL_BYTES = 8 * 1024 * 1024
LITTER_BYTES = 16 * 1024 * 1024
LITTER_FILES = 20

_CURE_SIZE = "give it more: docker run --shm-size=1g, or mount -o remount,size=1g /dev/shm"


def look_at_users(around: Around) -> Sequence[Finding]:
    """Fast DDS's shared memory between different users delivers nothing, while the graph looks perfect."""
    if around.config.ros2.enabled is False or not around.shm.is_dir():
        return [skip("ROS 2 over shared memory is not used here")]
    mine = {_daemons_user(around)}
    living = {f.uid for f in shared_files(around.shm, around.proc) if f.fast_dds and f.held}
    others = living - mine
    if not others:
        return [ok("one user only")]
    names = ", ".join(sorted(_user_name(uid) for uid in others))
    seen = (
        f"ROS 2 programs of other users than {_user_name(next(iter(mine)))} share {around.shm}: {names}; Fast DDS's"
        " shared memory delivers nothing between users, and says nothing"
    )
    cure = "run them as the same user, or with FASTDDS_BUILTIN_TRANSPORTS=UDPv4"
    transport = around.config.ros2.transport
    if transport == "shared_memory":
        return [fail(seen, f"set ros2.transport to auto or udp; or {cure}")]
    if transport == "udp":
        return [ok(f"other users' ROS 2 programs are here ({names}); ros2.transport is udp, which reaches them")]
    return [warn(seen, f"Midspan (ros2.transport: auto) turns to UDP by itself; among themselves: {cure}")]


def look_at_size(around: Around) -> Sequence[Finding]:
    """How much room there is."""
    if not around.shm.is_dir():
        return [skip(f"no {around.shm} here")]
    stat = os.statvfs(around.shm)
    whole, free = stat.f_blocks * stat.f_frsize, stat.f_bavail * stat.f_frsize
    text = f"{around.shm}: {free / 1e6:.0f} MB free of {whole / 1e6:.0f} MB"
    if free < FULL_BYTES:
        return [fail(f"{text}; large messages fall back to slower ways, and programs fail to start", _CURE_SIZE)]
    if whole < SMALL_BYTES:
        return [warn(f"{text}; large messages of ROS 2 go in pieces or over UDP", _CURE_SIZE)]
    return [ok(text)]


def look_at_litter(around: Around) -> Sequence[Finding]:
    """Segments of processes that were killed."""
    if not around.shm.is_dir():
        return [skip(f"no {around.shm} here")]
    left = [f for f in shared_files(around.shm, around.proc) if f.held is False and not f.young and not f.port]
    size = sum(file.size for file in left)
    if size < LITTER_BYTES and len(left) < LITTER_FILES:
        return [ok(f"{len(left)} files left, {size / 1e6:.1f} MB")]
    dds, zenoh = [f for f in left if f.fast_dds], [f for f in left if not f.fast_dds]
    cures = []
    if dds:
        cures.append("'fastdds shm clean', or a restart of Midspan's ros2 worker, removes Fast DDS's")
    if zenoh:
        cures.append(f"rm {' '.join(str(f.path) for f in zenoh[:3])}{' ...' if len(zenoh) > 3 else ''}")
    seen = f"{len(left)} files ({size / 1e6:.0f} MB) in {around.shm} belong to no process any more: theirs were killed"
    return [warn(seen, "; ".join(cures))]


def _daemons_user(around: Around) -> int:
    """The running ros2 worker's user; where none runs, ours, who would start it."""
    for document in around.hub.of_side("ros2"):
        process = around.process(document)
        if process is not None:
            return process.uids().effective
    return os.geteuid()


def _user_name(uid: int) -> str:
    import pwd

    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"user {uid}"
