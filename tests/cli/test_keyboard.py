"""Key presses in a pseudo-terminal."""

from __future__ import annotations

import os
import pty

from bridge.cli.keyboard import pressed, raw


def test_ctrl_s_is_a_key() -> None:
    """Otherwise the terminal would stop the output of a command, which would wait while it holds a robot's control."""
    primary, secondary = pty.openpty()
    try:
        with raw(secondary):
            os.write(primary, b"\x13i")
            assert [*pressed(secondary, 20)] == ["\x13", "i"]
    finally:
        os.close(primary)
        os.close(secondary)
