"""``python -m bridge.cli.child worker NAME --supervised``: the command line, in a process that the daemon watches."""

from __future__ import annotations

import sys

from bridge.daemon.begin import begin

if __name__ == "__main__":
    heart = begin()
    try:
        from bridge.cli.main import main

        sys.exit(main())
    finally:
        heart.close()
