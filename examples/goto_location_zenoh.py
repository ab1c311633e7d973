"""Go to a location, unaware of which framework plans the way: with zenoh and JSON alone.

    python3 goto_location_zenoh.py kitchen [tcp/robot:7447]

The keys are those of `zenoh.yaml` beside this file, a part of Midspan's configuration.
"""

import json
import queue
import sys

import zenoh

ENDS = ("goal_reached", "aborted", "failing", "error", "idle")


def main(name: str, router: str = "tcp/127.0.0.1:7447") -> int:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([router]))
    heard: queue.Queue[dict] = queue.Queue()
    with zenoh.open(config) as session:
        session.declare_subscriber("robot/navigation", lambda sample: heard.put(json.loads(sample.payload.to_bytes())))
        for reply in session.get("robot/go_to", payload=json.dumps({"name": name}), timeout=30):
            if not reply.ok:
                sys.exit(reply.err.payload.to_string())
            said = json.loads(reply.ok.payload.to_bytes())
            print(said["message"], flush=True)
            if not said["success"]:
                return 1
            break
        else:
            sys.exit("nobody answers at robot/go_to")
        begun = False
        while True:
            status = heard.get(timeout=3600)
            print(status["state"], status["reason"], flush=True)
            begun = begun or status["state"] not in ENDS
            if begun and status["state"] in ENDS:
                return int(status["state"] != "goal_reached")


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
