"""``python -m yarp_compat script.py ...`` runs a script that imports ``yarp``, unchanged.

``python -m yarp_compat --check script.py ...`` lists names of YARP that scripts use, but this package lacks, without
running the scripts.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import yarp_compat
from yarp_compat import as_yarp, check

USAGE = """usage: python -m yarp_compat script.py [arguments ...]
       python -m yarp_compat --check script.py [folder ...]"""

HELP = f"""{USAGE}

Runs a script for YARP's Python bindings (`import yarp`) without YARP, with all arguments that follow it.

  --check     list the YARP names in scripts that this package lacks, without running them
  -h, --help  show this help"""


def main() -> None:
    """Run the script that the command line names, or check scripts."""
    arguments = sys.argv[1:]
    if not arguments:
        sys.exit(USAGE)
    if arguments[0] in ("-h", "--help") or (arguments[0] == "--check" and {"-h", "--help"}.intersection(arguments)):
        sys.stdout.write(f"{HELP}\n")
        return
    if arguments[0] == "--check":
        sys.exit(check.main(arguments[1:]))
    script = Path(arguments[0])
    if arguments[0].startswith("-") and not script.exists():
        sys.exit(f"yarp_compat: unknown option {arguments[0]!r}\n{USAGE}")
    if not script.exists():
        sys.exit(f"yarp_compat: script {arguments[0]!r} not found\n{USAGE}")
    if script.is_dir() and not (script / "__main__.py").is_file():
        sys.exit(f"yarp_compat: {arguments[0]!r} is a folder without __main__.py\n{USAGE}")
    sys.modules["yarp"] = yarp_compat
    sys.argv = arguments
    # the second folder is for processes that multiprocessing spawns: they inherit the path and import again
    sys.path[:1] = [str(script.resolve().parent), str(Path(as_yarp.__file__).parent)]
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
