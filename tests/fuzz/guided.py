"""``python -m tests.fuzz.guided NAME``: the same targets with atheris, which is guided by branch coverage.

It finds inputs that need several right guesses in sequence, but is slower at first. Atheris is not a dependency: ``pip
install atheris`` (Linux). The corpus stays in its folder, and the next run continues with it.
"""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import warnings
from pathlib import Path

import atheris  # type: ignore[import-not-found]

_INSTRUMENTED = ["bridge", "http", "json", "urllib", "xmlrpc", "yaml"]


def main() -> None:
    """Fuzz one target until the time is over or an input fails; a failing input is saved next to the corpus."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.guided", description=__doc__)
    parser.add_argument("name", help="a target, as 'python -m tests.fuzz' lists them")
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--corpus", type=Path, default=Path(tempfile.gettempdir()) / "midspan-fuzz-corpus")
    args = parser.parse_args()
    logging.disable()
    warnings.simplefilter("ignore")
    with atheris.instrument_imports(include=_INSTRUMENTED):
        from tests.fuzz.targets import TARGETS

        subject = TARGETS[args.name].make()
    folder = args.corpus / args.name
    folder.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(subject.seeds):
        (folder / f"seed-{number}").write_bytes(seed)
    dictionary = args.corpus / f"{args.name}.dict"
    short = [token for token in subject.tokens if 0 < len(token) < 60]
    dictionary.write_text("".join('"' + "".join(f"\\x{byte:02x}" for byte in token) + '"\n' for token in short))

    def run_input(data: bytes) -> None:
        try:
            subject.parse(data)
        except subject.refuses:
            return

    options = {
        **({"dict": dictionary} if short else {}),
        "max_total_time": args.seconds,
        "max_len": subject.largest,
        "timeout": 4,
        "artifact_prefix": args.corpus / f"{args.name}-found-",
    }
    atheris.Setup([sys.argv[0], str(folder), *(f"-{key}={value}" for key, value in options.items())], run_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
