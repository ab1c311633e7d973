"""Small message packages for the builder's tests."""

from __future__ import annotations

PARTS = {
    "msg/Thing.msg": """# a comment with "quotes" and a [unit]
string RED='red'
string TRICKY=a"b; it's %d */ {}
uint8 LEVEL=3
std_msgs/Header header
  int16[3] triple          # an indented line
float64[] values
string<=5[<=4] names
geometry_msgs/msg/Point[] points
bool on true
""",
    "srv/Thing.srv": "uint8 NONE=0\nThing thing\n---\nuint8 NONE=0\nbool done\n",
    "action/Thing.action": "int32 goal\n---\nuint8 NONE=0\nint32 result\n---\nuint8 NONE=0\nThing at\n",
}
"""Three kinds of the same name, and equal constants in two parts: both would make a naive use of rosidl fail."""

WHOLE = {"msg/Whole.msg": "midspan_parts_msgs/Thing[] parts\ntf2_msgs/TFMessage where\n"}

PACKAGES = {"midspan_parts_msgs": PARTS, "midspan_whole_msgs": WHOLE}
"""The second package depends on the first one, and on one of Midspan's packages."""
