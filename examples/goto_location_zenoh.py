"""Go to a location with zenoh and JSON only, whichever framework the planner belongs to.

    python3 goto_location_zenoh.py kitchen [tcp/robot:7447]

The keys are those of `zenoh.yaml` in this folder, which is part of Midspan's configuration.
"""

import json
import queue
import sys

import zenoh

GO_TO, STATUS = "robot/go_to", "robot/navigation"
ENDS = ("goal_reached", "aborted", "idle")
SILENCE = 5.0


def newest(session: zenoh.Session) -> dict | None:
    """Query the last navigation status, which Midspan retains for queries."""
    for reply in session.get(STATUS, timeout=30):
        if reply.ok:
            return json.loads(reply.ok.payload.to_bytes())
    return None


def main(name: str, router: str = "tcp/127.0.0.1:7447") -> int:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([router]))
    statuses: queue.Queue[dict] = queue.Queue()
    with zenoh.open(config) as session:
        session.declare_subscriber(STATUS, lambda sample: statuses.put(json.loads(sample.payload.to_bytes())))
        last = newest(session)  # the status of an earlier goal
        for reply in session.get(GO_TO, payload=json.dumps({"name": name}), timeout=30):
            if not reply.ok:
                sys.exit(reply.err.payload.to_string())
            answer = json.loads(reply.ok.payload.to_bytes())
            print(answer["message"], flush=True)
            if not answer["success"]:
                return 1
            break
        else:
            sys.exit("no reply on robot/go_to: is Midspan running?")
        while True:
            try:
                status = statuses.get(timeout=SILENCE)
            except queue.Empty:  # only changes are published; a change may be lost, or Midspan may have stopped
                status = newest(session) or sys.exit("no navigation status: Midspan or the router has stopped")
            if status == last:
                continue
            last = status
            print(status["state"], status["reason"], flush=True)
            if status["state"] in ENDS:
                return int(status["state"] != "goal_reached")


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
