"""How a service is spelled in DDS: a topic for its requests, one for its replies, and a type for each.

From rmw_dds_common and rmw_fastrtps (Jazzy): ``/add`` of ``example/srv/Add`` has the topics ``rq/addRequest`` and
``rr/addReply`` with the types ``example::srv::dds_::Add_Request_`` and ``example::srv::dds_::Add_Response_``.
"""

from __future__ import annotations

import re

_REQUEST = re.compile(r"^rq(/.+)Request$")
_TYPE = re.compile(r"^(\w+)::(srv|action)::dds_::(\w+)_Request_$")


def request_topic(service: str) -> str:
    """The topic that servers read and clients write."""
    return f"rq{service}Request"


def reply_topic(service: str) -> str:
    """The topic that servers write and clients read."""
    return f"rr{service}Reply"


def service_of(topic: str) -> str:
    """The service whose requests a topic has, "" where it is none's."""
    match = _REQUEST.match(topic)
    return match[1] if match else ""


def service_type(dds_type: str) -> str:
    """``package/srv/Name`` of a request's type in DDS, as it stands where it is none."""
    match = _TYPE.match(dds_type)
    return f"{match[1]}/{match[2]}/{match[3]}" if match else dds_type
