"""Clients of programs that are no robots' parts, as devices with the options of YARP's own."""

from __future__ import annotations

from yarp_compat.dev.drivers.registry import DeviceOptions, OpenDevice
from yarp_compat.dev.llm import LLMClient


def llm(options: DeviceOptions) -> OpenDevice:
    """``local`` and ``remote``: the names of both ports."""
    client = LLMClient(options.port("remote"), options.port("local"), naming=options.naming).open()
    return OpenDevice(client.close, {"ILLM": client.llm})
