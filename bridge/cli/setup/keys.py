"""``midspan keys``: the certificates by which machines know each other."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.cli.arguments import add_verb, add_verbs
from bridge.cli.output import CliError

if TYPE_CHECKING:
    from bridge.hub.security.certificates import Certificate


MOST_DAYS = 3650

_EPILOG = """\
example, for a robot and an operator's computer:
  midspan keys make robot1 192.168.1.20
  midspan keys make operator1
  midspan keys show

The first 'make' makes the authority that signs all the others. Its key, ca.key, stays in this folder alone: whoever has
it can make certificates of any name. Copy to each machine ca.pem and its own two files, as 'make' says.
"""


def register(parser: argparse.ArgumentParser) -> None:
    """Describe the verb and its arguments."""
    actions = add_verbs(
        parser,
        "Makes or shows the certificates by which the machines of a fleet know each other over TLS (hub.open).",
        dest="action",
    )
    parser.epilog = _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    make = add_verb(actions, "make", run, "make a machine's key and certificate, first the authority's", hub=False)
    make.add_argument("name", metavar="NAME", help="the machine's name, as 'name' in its configuration")
    make.add_argument("addresses", metavar="ADDRESS", nargs="*", help="names and addresses besides NAME, NAME.local")
    make.add_argument(
        "--days", type=_days, default=730, metavar="N", help=f"days until it expires (default 730, at most {MOST_DAYS})"
    )
    make.add_argument("--replace", action="store_true", help="make it anew where it is there already")
    show = add_verb(
        actions, "show", run, "show certificates: names, and when they expire",
        "Shows certificates: whose they are, their names and addresses, and when they expire. Exit code 1 where one has"
        " expired.", hub=False,
    )  # fmt: skip
    show.add_argument("files", type=Path, nargs="*", metavar="FILE", help="certificates, or folders (default: DIR)")
    show.add_argument("--json", action="store_true", help="print JSON")
    for action in (make, show):
        action.add_argument("--folder", type=Path, metavar="DIR", help="keys' folder (default: ~/.config/midspan/keys)")


def run(args: argparse.Namespace) -> int:
    """Make or show."""
    from bridge.hub.security.certificates import CertificateError

    folder = (args.folder or _default_folder()).expanduser().absolute()
    try:
        if args.action == "show":
            return _show(args.files or [folder], as_json=args.json)
        _make(folder, args)
    except CertificateError as err:
        raise CliError(str(err)) from None
    return 0


def _make(folder: Path, args: argparse.Namespace) -> None:
    from bridge.hub.security.certificates import Authority

    authority = Authority(folder)
    if not authority.exists():
        made = authority.make()
        print(f"made the authority: {made.file}, valid until {made.until:%Y-%m-%d}")
        print(f"  keep {folder}/ca.key here and safe, and copy it nowhere: it makes certificates of any name\n")
    made = authority.issue(args.name, args.addresses, args.days, replace=args.replace)
    print(f"made {args.name}.pem and {args.name}.key in {folder}")
    print(f"  valid until {made.until:%Y-%m-%d}, for connecting to {', '.join(made.names)}\n")
    print(_next_steps(folder, args.name))


def _next_steps(folder: Path, name: str) -> str:
    keys = "/etc/midspan/keys"
    files = " ".join(str(folder / file) for file in ("ca.pem", f"{name}.pem", f"{name}.key"))
    return f"""\
Next, on {name}, as root (the service's user is midspan, unless it was installed with another):
  install -d -o midspan -m 700 {keys}
  install -o midspan -m 600 FILES {keys}
where FILES are these three, copied there:
  {files}
and in its configuration:
  name: {name}
  hub:
    open:
      listen: [tls/0.0.0.0:7448]      # or connect: [tls/OTHER:7448]
      trusted: []                     # names of the machines that may command it"""


def _show(places: list[Path], *, as_json: bool) -> int:
    found = [certificate for place in places for certificate in _certificates(place)]
    expired = any(certificate.days_left() < 0 for certificate in found)
    if as_json:
        print(json.dumps([_document(certificate) for certificate in found], indent=2))
        return int(expired)
    if not found:
        raise CliError(f"no certificates in {', '.join(map(str, places))}; 'midspan keys make NAME' makes them")
    rows = [("NAME", "VALID UNTIL", "LEFT", "CONNECT BY", "FILE"), *(_row(each) for each in found)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        print("  ".join(word.ljust(width) for word, width in zip(row, widths, strict=True)).rstrip())
    return int(expired)


def _row(certificate: Certificate) -> tuple[str, ...]:
    left = certificate.days_left()
    return (
        "(authority)" if certificate.authority else certificate.name,
        f"{certificate.until:%Y-%m-%d}",
        "expired" if left < 0 else f"{left} days",
        ", ".join(certificate.names) or "-",
        str(certificate.file),
    )


def _certificates(place: Path) -> list[Certificate]:
    from bridge.hub.security.certificates import read_certificate

    # the default folder may not be there yet
    files = [place] if place.suffix else sorted(place.glob("*.pem"))
    return [read_certificate(file) for file in files]


def _document(certificate: Certificate) -> dict[str, Any]:
    return {
        "file": str(certificate.file),
        "name": certificate.name,
        "authority": certificate.authority,
        "issuer": certificate.issuer,
        "names": list(certificate.names),
        "until": certificate.until.isoformat(),
        "days_left": certificate.days_left(),
    }


def _default_folder() -> Path:
    base = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(base) / "midspan" / "keys"


def _days(text: str) -> int:
    days = int(text) if text.isascii() and text.isdigit() else 0
    if not 1 <= days <= MOST_DAYS:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of days from 1 to {MOST_DAYS}")
    return days
