"""``python -m yarp_compat script.py ...`` runs a script that imports ``yarp``, unchanged.

``python -m yarp_compat --check script.py ...`` lists the names of YARP that it uses and that are missing here, and runs
nothing.
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

Runs a script for YARP's Python bindings (`import yarp`) without YARP. The script gets all arguments that follow it.

  --check     list the names of YARP that scripts use and that are missing here; runs nothing
  -h, --help  show this help"""


def main() -> None:
    """Run the script that the command line names, or check scripts."""
    words = sys.argv[1:]
    if not words:
        sys.exit(USAGE)
    if words[0] in ("-h", "--help") or (words[0] == "--check" and {"-h", "--help"}.intersection(words)):
        sys.stdout.write(f"{HELP}\n")
        return
    if words[0] == "--check":
        sys.exit(check.main(words[1:]))
    script = Path(words[0])
    if words[0].startswith("-") and not script.exists():
        sys.exit(f"yarp_compat: unknown option {words[0]!r}\n{USAGE}")
    if not script.exists():
        sys.exit(f"yarp_compat: script {words[0]!r} not found\n{USAGE}")
    if script.is_dir() and not (script / "__main__.py").is_file():
        sys.exit(f"yarp_compat: {words[0]!r} is a folder without __main__.py\n{USAGE}")
    sys.modules["yarp"] = yarp_compat
    sys.argv = words
    # the second is for processes that multiprocessing starts by "spawn": they inherit the path and import again
    sys.path[:1] = [str(script.resolve().parent), str(Path(as_yarp.__file__).parent)]
    runpy.run_path(sys.argv[0], run_name="__main__")


if __name__ == "__main__":
    main()
