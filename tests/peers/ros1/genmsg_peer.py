"""Parses definitions with the real genmsg and genaction; run by the system's Python.

It reads one JSON list from standard input: ``{"kind", "text"}``, with ``msg``, ``srv`` or ``action`` and the file's
text. For each it writes ``{"constants", "md5", "parts"}``: the constants' values by name, genmsg's md5 (not for an
action), and the names of the fields in each part; or ``{"error"}``.
"""

import importlib.util
import json
import sys

from genmsg import MsgContext, gentools, msg_loader

GENACTION = "/usr/lib/actionlib_msgs/genaction.py"


def read(kind, text):
    context = MsgContext.create_default()
    if kind == "msg":
        specs = [msg_loader.load_msg_from_string(context, text, "my_msgs/Sample")]
        md5 = gentools.compute_md5(context, specs[0])
    elif kind == "srv":
        service = msg_loader.load_srv_from_string(context, text, "my_msgs/Sample")
        specs, md5 = [service.request, service.response], gentools.compute_md5(context, service)
    else:
        spec = importlib.util.spec_from_file_location("genaction", GENACTION)
        genaction = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(genaction)
        parts = genaction.parse_action_spec(text)
        specs, md5 = [msg_loader.load_msg_from_string(context, part, "my_msgs/Sample") for part in parts], ""
    constants = {constant.name: constant.val for spec in specs for constant in spec.constants}
    return {"constants": constants, "md5": md5, "parts": [spec.names for spec in specs]}


def main():
    answers = []
    for item in json.load(sys.stdin):
        try:
            answers.append(read(**item))
        except Exception as err:
            answers.append({"error": repr(err)})
    json.dump(answers, sys.stdout)


main()
