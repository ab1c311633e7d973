"""Vectors and matrices with YARP's methods, and as numpy arrays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yarp_compat.sig.matrix import Matrix
from yarp_compat.sig.vector import Vector, VectorFloat, VectorInt, VectorInt8, VectorOf, VectorUInt8, vector_of
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile

KINDS = VectorOf.__subclasses__()


def elements(kind: type[VectorOf]) -> st.SearchStrategy[list[float]]:
    if kind.dtype.kind == "f":
        element = st.floats(width=8 * kind.dtype.itemsize, allow_nan=False)
    else:
        limits = np.iinfo(kind.dtype)
        element = st.integers(int(limits.min), int(limits.max))
    return st.lists(element, max_size=50)


@given(st.data(), st.sampled_from(KINDS), st.sampled_from(Profile))
def test_every_element_type_survives_the_wire(data: st.DataObject, kind: type[VectorOf], profile: Profile) -> None:
    values = data.draw(elements(kind))
    vector = kind(values)
    payload = vector.to_bytes(profile)
    assert len(payload) == 8 + kind.dtype.itemsize * len(values)
    assert list(kind.from_bytes(payload, profile)) == list(vector) == values
    if kind.dtype.kind != "u":
        assert binary.decode(payload, profile) == values
    if values:
        assert payload[:4] != b"\0\1\0\0"
    if kind.dtype.itemsize == 8 or len(values) != 1:
        assert kind.from_bytes(payload) == vector


@given(st.lists(st.integers(-(2**62), 2**62) | st.floats(allow_nan=False), max_size=20), st.sampled_from(Profile))
def test_vector_of_doubles_reads_any_list_of_numbers(values: list[float], profile: Profile) -> None:
    vector = Vector.from_bytes(binary.encode(values, profile), profile)
    assert list(vector) == list(map(float, values))


@pytest.mark.parametrize(
    ("kind", "text"),
    [(VectorInt8, "1 200"), (VectorInt, "1 2.5"), (VectorInt, "3000000000 1"), (Vector, "a b"), (Vector, "1 (2)"),
     (VectorUInt8, "-1 2")],
)  # fmt: skip
def test_numbers_that_do_not_fit_the_type_are_refused(kind: type[VectorOf], text: str) -> None:
    vector = kind([7])
    with pytest.raises(WireError):
        vector.from_text(text)
    assert list(vector) == [7]


def test_vector_methods_work_as_in_yarp() -> None:
    vector = Vector(3, 1.5)
    assert (vector.size(), vector.length(), len(vector), list(vector)) == (3, 3, 3, [1.5] * 3)
    vector.set(1, 2)
    vector[2] = 3
    assert (vector.get(0), vector[1], vector.access(2)) == (1.5, 2.0, 3.0)
    assert vector.toString(2) == " 1.50\t 2.00\t 3.00"
    assert vector.toString(1, 5) == "  1.5   2.0   3.0"
    assert VectorInt([1, -2]).toString_c() == "1 -2"
    vector.resize(4)
    assert list(vector) == [1.5, 2, 3, 0]
    vector.resize(2, 9)
    assert list(vector) == [9, 9]
    vector.push_back(4)
    vector.push_back(5)
    vector.pop_back()
    assert list(vector) == [9, 9, 4]
    assert list(vector.subVector(1, 2)) == [9, 4]
    assert len(vector.subVector(1, 3)) == 0
    assert vector.setSubvector(1, Vector([7, 8]))
    assert not vector.setSubvector(2, Vector([7, 8]))
    assert list(vector) == [9, 7, 8]
    assert vector.isEqual(Vector([9, 7, 8]))
    assert vector.notEqual(VectorInt([9, 7, 8]))
    vector.zero()
    assert list(vector) == [0, 0, 0]
    vector.clear()
    with pytest.raises(IndexError):
        vector.pop_back()
    assert (vector.getElementSize(), vector.getBottleTag(), Vector.TYPE) == (8, 10, "yarp/vector")
    assert len(Vector(1000)) == 1000
    copied = Vector(vector := Vector([1, 2]))
    copied[0] = 5
    assert (list(vector), list(Vector(Matrix(3, 3).eye().getRow(0))), list(Vector(range(3)))) == (
        [1, 2],
        [1, 0, 0],
        [0, 1, 2],
    )


def test_push_back_takes_constant_time() -> None:
    vector = VectorInt()
    for number in range(10_000):
        vector.push_back(number)
    assert vector.capacity() < 20_001
    assert list(vector) == list(range(10_000))


def test_numpy_shares_the_memory() -> None:
    array = np.arange(3.0)
    vector = Vector.of(array)
    vector[0] = 5
    assert array[0] == 5
    vector.numpy()[1] = 6
    assert np.asarray(vector).tolist() == [5, 6, 2]
    assert np.array(vector, dtype=np.float32).dtype == np.float32
    for value in (vector, Matrix(1, 2)):
        assert not np.shares_memory(np.array(value, copy=True), value.numpy())
        with pytest.raises(ValueError, match="without a copy"):
            value.__array__(np.float32, copy=False)
    assert vector_of(np.uint8) is VectorUInt8
    with pytest.raises(TypeError):
        vector_of(complex)


@pytest.mark.parametrize("writable", [False, True])
def test_received_vector_is_a_view_until_it_changes(writable: bool) -> None:
    payload = Vector([1, 2, 3]).to_bytes()
    memory = bytearray(payload) if writable else payload
    vector = Vector.from_bytes(memory)
    assert np.shares_memory(vector.numpy(), np.frombuffer(memory, np.uint8))
    vector[0] = 9
    assert list(vector) == [9, 2, 3]
    assert memory == (Vector([9, 2, 3]).to_bytes() if writable else payload)


def test_floats_of_yarp_3_are_not_mistaken_for_doubles_of_yarp_4() -> None:
    assert VectorFloat([1, 2]).to_bytes(Profile.YARP3).hex() == "80010000020000000000803f00000040"
    assert list(Vector.from_bytes(VectorFloat([1, 2]).to_bytes(Profile.YARP4))) == [1, 2]
    assert list(Vector.from_bytes(VectorFloat([1, 2]).to_bytes(Profile.YARP3))) == [1, 2]


@given(st.integers(0, 6), st.integers(0, 6), st.sampled_from(Profile))
def test_matrices_survive_the_wire(rows: int, cols: int, profile: Profile) -> None:
    matrix = Matrix(np.arange(rows * cols).reshape(rows, cols))
    assert Matrix.from_bytes(matrix.to_bytes(profile), profile) == matrix
    assert (matrix.rows(), matrix.cols()) == (rows, cols)


def test_matrix_methods_work_as_in_yarp() -> None:
    matrix = Matrix(2, 3)
    matrix.set(0, 1, 5)
    matrix[1, 2] = 6
    assert (matrix.get(0, 1), matrix.access(1, 2), matrix[0, 0]) == (5, 6, 0)
    assert matrix.transposed().numpy().tolist() == [[0, 0], [5, 0], [0, 6]]
    assert list(matrix.getRow(0)) == [0, 5, 0]
    assert list(matrix.getCol(2)) == [0, 6]
    assert matrix.setRow(1, Vector([1, 2, 3]))
    assert matrix.setCol(0, Vector([8, 9]))
    assert not matrix.setRow(2, Vector([1, 2, 3]))
    assert not matrix.setRow(0, Vector([1, 2]))
    assert matrix.numpy().tolist() == [[8, 5, 0], [9, 2, 3]]
    assert matrix.submatrix(0, 1, 1, 2).numpy().tolist() == [[5, 0], [2, 3]]
    assert matrix.setSubmatrix(Matrix(2, 2).eye(), 0, 1)
    assert matrix.toString(0, -1, " ; ") == " 8\t 1\t 0 ;  9\t 0\t 1"
    matrix.resize(3, 2)
    assert matrix.numpy().tolist() == [[8, 1], [9, 0], [0, 0]]
    assert Matrix(2, 2).diagonal(Vector([1, 2])).numpy().tolist() == [[1, 0], [0, 2]]
    read = Matrix.from_bytes(matrix.to_bytes())
    read[0, 0] = -1
    assert read.get(0, 0) == -1
    assert read.isEqual(Matrix([[-1, 1], [9, 0], [0, 0]]))


def test_functions_with_a_pointer_in_cpp_fill_the_vector() -> None:
    vector = Vector(2)
    vector.data()[1] = 1.5
    assert list(vector) == [0.0, 1.5]
