"""Point clouds of all layouts, and clouds with inconsistent fields."""

import numpy as np
import pytest

from bridge.messages.point_cloud import CloudError
from navigation.clouds import MOST_POINTS, read_points

POINTS = np.array([[1.0, -2.0, 0.5], [3.0, 4.0, -5.0], [6.0, 7.0, 8.0], [-9.0, 1.0, 2.0]])


def cloud(points=POINTS, kind="<f4", datatype=7, order="xyz", gap=0, height=1, row_gap=0):
    """Return a cloud of points (n, 3), with padding before the first field and between rows."""
    layout = np.dtype(
        {"names": list(order), "formats": [kind] * 3, "offsets": [gap + i * int(kind[2]) for i in range(3)]}
    )
    rows = np.zeros((height, len(points) // height), layout)
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis].reshape(rows.shape)
    data = b"".join(row.tobytes() + bytes(row_gap) for row in rows)
    fields = layout.fields or {}
    return {
        "width": rows.shape[1], "height": height, "point_step": layout.itemsize,
        "row_step": rows.shape[1] * layout.itemsize + row_gap, "is_bigendian": kind[0] == ">", "is_dense": False,
        "fields": [{"name": n, "offset": fields[n][1], "datatype": datatype, "count": 1} for n in layout.names],
        "data": np.frombuffer(data, np.uint8),
    }  # fmt: skip


@pytest.mark.parametrize(("kind", "datatype"), [("<f4", 7), (">f4", 7), ("<f8", 8), (">f8", 8), ("<i2", 3), (">i4", 5)])
@pytest.mark.parametrize(("order", "gap", "height", "row_gap"), [("xyz", 0, 1, 0), ("zxy", 4, 2, 12), ("yxz", 3, 4, 1)])
def test_points_of_any_layout_are_read(kind, datatype, order, gap, height, row_gap):
    expected = POINTS.astype(kind).astype(np.float32)
    points_read = read_points(cloud(POINTS, kind, datatype, order, gap, height, row_gap))
    assert points_read.dtype == np.float32
    np.testing.assert_array_equal(points_read, expected)


def test_points_that_are_not_finite_are_dropped_even_if_is_dense():
    points = np.array([[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0, 1e300], [4.0, 5.0, 6.0]])
    points_read = read_points({**cloud(points, "<f8", 8), "is_dense": True})
    np.testing.assert_array_equal(points_read, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    far = np.array([[3.4e38, 0.0, 0.0], [1.0, 2.0, 3.0], [0.0, 0.0, -1e9]])
    np.testing.assert_array_equal(read_points(cloud(far)), [[1.0, 2.0, 3.0]])
    assert read_points({**cloud(), "width": 0, "data": b""}).shape == (0, 3)


def test_the_first_of_several_fields_with_one_name_is_used():
    message = cloud()
    message["fields"].append({"name": "x", "offset": 4, "datatype": 7, "count": 1})
    np.testing.assert_array_equal(read_points(message), POINTS)


def field(name, changed):
    return {"fields": [{**f, **(changed if f["name"] == name else {})} for f in cloud()["fields"]]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"width": 100_000_000}, "width, height: 100000000 x 1 points are declared, more than"),
        ({"width": 65536, "height": 65536}, "width, height"),
        ({"width": 5, "row_step": 60}, "data: 48 bytes, but 1 rows of 60 .* need 60"),
        ({"height": 2}, "data: 48 bytes"),
        ({"row_step": 47}, "row_step: 47 bytes cannot hold 4 points of 12 bytes"),
        ({"point_step": 11}, "fields.z.offset: byte 8 is not within a point of 11 bytes"),
        ({"point_step": 0}, "fields.x.offset"),
        ({"fields": cloud()["fields"][:2]}, "fields: no z among x, y"),
        ({"fields": []}, "fields: no x, y, z among none"),
        (field("y", {"datatype": 9}), "fields.y.datatype: 9"),
        (field("x", {"count": 2}), "fields.x.count"),
        (field("z", {"offset": 4_294_967_295}), "fields.z.offset"),
        ({"data": b""}, "data: 0 bytes"),
        ({"width": 1, "point_step": 2**32 - 1, "row_step": 2**32 - 1}, "data: 48 bytes"),
    ],
)
def test_an_invalid_cloud_is_rejected_with_the_field_name(change, words):
    with pytest.raises(CloudError, match=words):
        read_points({**cloud(), **change})


def test_a_cloud_may_have_the_maximum_number_of_points():
    assert MOST_POINTS >= 640 * 480
    with pytest.raises(CloudError, match="more than 3"):
        read_points(cloud(), most=3)
    assert len(read_points(cloud(), most=4)) == 4


@pytest.mark.parametrize("row_gap", [0, 12])
def test_a_large_cloud_is_read_in_part(row_gap):
    points = np.stack((np.arange(600.0), np.ones(600), np.zeros(600)), axis=1)
    points[1::2, 2] = np.nan
    message = cloud(points, height=20, row_gap=row_gap)
    np.testing.assert_array_equal(read_points(message, enough=300)[:, 0], np.arange(0.0, 600.0, 2.0))
    few = read_points(message, enough=100)[:, 0]
    np.testing.assert_array_equal(few, np.arange(0.0, 600.0, 6.0))
    rows = {int(x) // 30 for x in few}
    assert len(rows) == 20
    assert len({int(x) % 30 for x in read_points(message, enough=60)[:, 0]}) > 2, "the same columns in all rows"
