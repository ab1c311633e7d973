"""Visit rooms in turn, for several rounds; rooms that cannot be reached are skipped in that round.

python patrol.py kitchen hall bedroom --rounds 3
"""

import argparse

import yarp_compat as yarp
from yarp_compat.dev.returnvalue import CallFailed

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("places", nargs="+", help="locations or areas")
parser.add_argument("--rounds", type=int, default=1, help="number of rounds (default 1)")
parser.add_argument("--patience", type=float, default=300.0, help="seconds until a place is skipped (default 300)")
args = parser.parse_args()

with yarp.Navigation2DClient() as robot:
    for number in range(1, args.rounds + 1):
        for place in args.places:
            try:
                robot.go(place)
                outcome = yarp.statusToString(robot.wait(args.patience))
            except CallFailed:
                outcome = "unknown place, or the goal was rejected"
            except TimeoutError as error:
                robot.stopNavigation()
                outcome = str(error)
            print(f"round {number}, {place}: {outcome}", flush=True)
