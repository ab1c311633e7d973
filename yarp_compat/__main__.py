"""``python -m yarp_compat script.py ...`` runs a script that says ``import yarp``, unchanged.

``python -m yarp_compat --check script.py ...`` says which names of YARP it uses that are not here, and runs nothing.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import yarp_compat
from yarp_compat import as_yarp, check


def main() -> None:
    """Run the script that the command line names, or look what it needs."""
    if len(sys.argv) < 2:
        sys.exit("usage: python -m yarp_compat [--check] script.py [arguments]")
    if sys.argv[1] == "--check":
        sys.exit(check.main(sys.argv[2:]))
    sys.modules["yarp"] = yarp_compat
    sys.argv = sys.argv[1:]
    # the second is for processes that multiprocessing starts by "spawn": they take the path over, and import anew
    sys.path[:1] = [str(Path(sys.argv[0]).resolve().parent), str(Path(as_yarp.__file__).parent)]
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
