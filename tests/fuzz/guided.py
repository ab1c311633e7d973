"""``python -m tests.fuzz.guided NAME``: the same targets under atheris, which is guided by all of the code's branches.

It finds what needs several right guesses in a row, and is slower to begin with. It is no dependency of ours: ``pip
install atheris`` (Linux). What it keeps stays in the folder, and the next run goes on from there.
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
    """Fuzz one target until the time is over or something is found; what was found is saved beside the corpus."""
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
    words = args.corpus / f"{args.name}.dict"
    short = [word for word in subject.words if 0 < len(word) < 60]
    words.write_text("".join('"' + "".join(f"\\x{byte:02x}" for byte in word) + '"\n' for word in short))

    def one(data: bytes) -> None:
        try:
            subject.parse(data)
        except subject.refuses:
            return

    options = {
        **({"dict": words} if short else {}),
        "max_total_time": args.seconds,
        "max_len": subject.largest,
        "timeout": 4,
        "artifact_prefix": args.corpus / f"{args.name}-found-",
    }
    atheris.Setup([sys.argv[0], str(folder), *(f"-{key}={value}" for key, value in options.items())], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
