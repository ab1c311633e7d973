"""Visit rooms one after the other, for some rounds; one that cannot be reached is left out this time.

python patrol.py kitchen hall bedroom --rounds 3
"""

import argparse

import yarp_compat as yarp
from yarp_compat.dev.returnvalue import CallFailed

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("places", nargs="+", help="locations or areas")
parser.add_argument("--rounds", type=int, default=1, help="how often (default 1)")
parser.add_argument("--patience", type=float, default=300.0, help="seconds for each (default 300)")
given = parser.parse_args()

with yarp.Navigation2DClient() as robot:
    for number in range(1, given.rounds + 1):
        for place in given.places:
            try:
                robot.go(place)
                said = yarp.statusToString(robot.wait(given.patience))
            except CallFailed:
                said = "there is no such place, or it was refused"
            except TimeoutError as late:
                robot.stopNavigation()
                said = str(late)
            print(f"round {number}, {place}: {said}", flush=True)
