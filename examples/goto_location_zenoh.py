"""Go to a location, unaware of which framework plans the way: with zenoh and JSON alone.

    python3 goto_location_zenoh.py kitchen [tcp/robot:7447]

The keys are those of `zenoh.yaml` beside this file, a part of Midspan's configuration.
"""

import json
import queue
import sys

import zenoh

GO_TO, STATUS = "robot/go_to", "robot/navigation"
ENDS = ("goal_reached", "aborted", "idle")
SILENCE = 5.0


def newest(session: zenoh.Session) -> dict | None:
    """How the robot gets on now: a status is kept for whoever asks."""
    for reply in session.get(STATUS, timeout=30):
        if reply.ok:
            return json.loads(reply.ok.payload.to_bytes())
    return None


def main(name: str, router: str = "tcp/127.0.0.1:7447") -> int:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([router]))
    heard: queue.Queue[dict] = queue.Queue()
    with zenoh.open(config) as session:
        session.declare_subscriber(STATUS, lambda sample: heard.put(json.loads(sample.payload.to_bytes())))
        last = newest(session)  # of what the robot did before
        for reply in session.get(GO_TO, payload=json.dumps({"name": name}), timeout=30):
            if not reply.ok:
                sys.exit(reply.err.payload.to_string())
            said = json.loads(reply.ok.payload.to_bytes())
            print(said["message"], flush=True)
            if not said["success"]:
                return 1
            break
        else:
            sys.exit("nobody answers at robot/go_to")
        while True:
            try:
                status = heard.get(timeout=SILENCE)
            except queue.Empty:  # told are changes alone; was one lost, or the robot?
                status = newest(session) or sys.exit("the robot is not heard any more")
            if status == last:
                continue
            last = status
            print(status["state"], status["reason"], flush=True)
            if status["state"] in ENDS:
                return int(status["state"] != "goal_reached")


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
