"""The error codes of Nav2's actions, as short reasons in English.

Source: the constants in ``nav2_msgs/action/*.action``, branches ``humble`` to ``lyrical`` of
ros-navigation/navigation2; no code changes its meaning between releases. Each action has its own range;
``bt_navigator`` copies the code of the failed action into the result of ``NavigateToPose`` and
``NavigateThroughPoses``, which also define codes since Kilted. Docking and FollowObject share 901 to 904.
Midspan's own codes are in `navigation.status.Fault`.
"""

from __future__ import annotations

_NO_TRANSFORM = "a transform is missing or too old"

_SERVERS = {  # any action, since Lyrical
    1: "an action server rejected the goal",
    2: "the goal could not be sent to an action server",
}
_CONTROL = {  # FollowPath; 108 since Lyrical
    100: "the controller failed",
    101: "the controller plugin is not configured",
    102: _NO_TRANSFORM,
    103: "the controller cannot use the path",
    104: "the controller found no valid command within its patience",
    105: "the robot makes no progress",
    106: "the controller finds no valid velocity command",
    107: "the controller timed out",
    108: "following the path timed out",
}
_PLANNING = {  # ComputePathToPose: 200 to 208; ComputePathThroughPoses: the same from 300, and 309
    0: "the planner failed",
    1: "the planner plugin is not configured",
    2: _NO_TRANSFORM,
    3: "the robot is outside the map",
    4: "the goal is outside the map",
    5: "the robot's position is occupied",
    6: "the goal is occupied",
    7: "the planner timed out",
    8: "no path to the goal",
}
_ROUTES = {  # ComputeRoute, ComputeAndTrackRoute
    400: "the route server failed",
    401: _NO_TRANSFORM,
    402: "the route server has no valid graph",
    403: "the route graph's nodes are ambiguous",
    404: "the route server timed out",
    405: "no route to the goal",
    406: "an operation on the route failed",
    407: "the route server's edge scorer is misused",
}
_SMOOTHING = {  # SmoothPath
    500: "the path smoother failed",
    501: "the smoother plugin is not configured",
    502: "the path smoother timed out",
    503: "the smoothed path is in collision",
    504: "the path cannot be smoothed",
    505: "the smoother cannot use the path",
}
_WAYPOINTS = {  # FollowWaypoints, FollowGPSWaypoints; from 602 on since Kilted
    600: "following the waypoints failed",
    601: "the task at a waypoint failed",
    602: "the goal has no valid waypoints",
    603: "a waypoint was missed",
}
_BEHAVIORS = {  # Spin, BackUp, DriveOnHeading, AssistedTeleop; Wait since Kilted
    700: "the spin failed",
    701: "the spin timed out",
    702: _NO_TRANSFORM,
    703: "an obstacle blocks the spin",
    710: "backing up failed",
    711: "backing up timed out",
    712: _NO_TRANSFORM,
    713: "the command to back up is invalid",
    714: "an obstacle blocks backing up",
    720: "driving on a heading failed",
    721: "driving on a heading timed out",
    722: _NO_TRANSFORM,
    723: "an obstacle blocks driving on the heading",
    724: "the command to drive on a heading is invalid",
    730: "assisted teleoperation failed",
    731: "assisted teleoperation timed out",
    732: _NO_TRANSFORM,
    740: "the wait failed",
    741: "the wait timed out",
}
_DOCKING = {  # DockRobot, UndockRobot; FollowObject; 907 since Kilted
    901: f"the dock is not in the database, or {_NO_TRANSFORM}",
    902: "the dock is invalid, or the object to follow is not detected",
    903: "the staging pose of the dock, or the object to follow, cannot be reached",
    904: "the dock is not detected, or following the object timed out",
    905: "the robot cannot be controlled into or out of the dock",
    906: "the robot does not charge",
    907: "docking timed out",
    999: "docking or following an object failed",
}
_NAVIGATOR = {  # NavigateToPose from 9000, NavigateThroughPoses from 9100; since Kilted
    0: "the navigator failed",
    1: "the behavior tree cannot be loaded",
    2: _NO_TRANSFORM,
    3: "the goal timed out",
}
_REASONS = {
    **_SERVERS,
    **_CONTROL,
    **{base + code: text for base in (200, 300) for code, text in _PLANNING.items()},
    309: "the goal names no poses",
    **_ROUTES,
    **_SMOOTHING,
    **_WAYPOINTS,
    **_BEHAVIORS,
    **_DOCKING,
    **{base + code: text for base in (9000, 9100) for code, text in _NAVIGATOR.items()},
}


def reason(code: int) -> str:
    """Return why Nav2 failed, by the ``error_code`` of a result; "" for 0 and for an unknown code."""
    return _REASONS.get(code, "")


def is_missing_transform(code: int) -> bool:
    """Whether a Nav2 server failed because of a missing transform, as it does while a localizer or a bridge starts."""
    return _REASONS.get(code) == _NO_TRANSFORM


def reason_text(reason: str, code: int) -> str:
    """Return a reason, completed with the meaning of a Nav2 error code if the reason lacks it."""
    meaning = _REASONS.get(code, "")
    if not meaning or f"Nav2 {code}" in reason:
        return reason
    if meaning in reason:
        return f"{reason} (Nav2 {code})"
    return f"{meaning} (Nav2 {code})" + (f": {reason}" if reason else "")
