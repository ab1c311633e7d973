"""A script that spawns processes (multiprocessing), which import yarp as well."""

import multiprocessing

import yarp


def total(text):
    bottle = yarp.Bottle(text)
    return sum(bottle.get(i).asInt32() for i in range(bottle.size()))


if __name__ == "__main__":
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        print(pool.map(total, ["1 2 3", "4 5"]))
