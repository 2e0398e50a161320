"""Pickles are read without running what they name."""

from __future__ import annotations

import pickle
import subprocess
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from chona_model.data.dataset import DatasetError
from chona_model.data.restricted_pickle import read_pickle


class _Attack:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return (subprocess.run, (["touch", str(self.mark)],))


@pytest.mark.parametrize("protocol", range(6))
def test_code_is_refused_by_name_and_not_run(tmp_path: Path, protocol: int) -> None:
    path, mark = tmp_path / "fit.pkl", tmp_path / "executed"
    path.write_bytes(pickle.dumps({"pose": np.zeros(3), "x": _Attack(mark)}, protocol=protocol))
    with pytest.raises(DatasetError, match=r"(subprocess|commands)\.run, which is refused"):
        read_pickle(path)
    assert not mark.exists()


@pytest.mark.parametrize(
    "text",
    [b"cbuiltins\neval\n(S'1'\ntR.", b"cos\nsystem\n(S'true'\ntR.", b"cnumpy\nload\n.", b"c__builtin__\ngetattr\n."],
)
def test_handwritten_code_is_refused(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "fit.pkl"
    path.write_bytes(text)
    with pytest.raises(DatasetError, match="is refused"):
        read_pickle(path)


@pytest.mark.parametrize("protocol", range(6))
@given(array=hnp.arrays(hnp.integer_dtypes() | hnp.floating_dtypes(), hnp.array_shapes(min_side=0, max_side=4)))
def test_arrays_come_back(tmp_path_factory: pytest.TempPathFactory, protocol: int, array: np.ndarray) -> None:
    path = tmp_path_factory.mktemp("pickle") / "fit.pkl"
    path.write_bytes(pickle.dumps({"a": array, "t": np.asfortranarray(array)}, protocol=protocol))
    content = read_pickle(path)
    for name in ("a", "t"):
        assert content[name].dtype == array.dtype.newbyteorder("=")
        assert content[name].tobytes() == array.astype(array.dtype.newbyteorder("=")).tobytes()


@given(
    content=st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner, inner),
        max_leaves=8,
    )
)
def test_plain_containers_come_back(tmp_path_factory: pytest.TempPathFactory, content: object) -> None:
    path = tmp_path_factory.mktemp("pickle") / "fit.pkl"
    path.write_bytes(pickle.dumps(content))
    assert read_pickle(path) == content


def test_scalars_sets_and_ordered_dictionaries_come_back(tmp_path: Path) -> None:
    path = tmp_path / "fit.pkl"
    path.write_bytes(pickle.dumps(OrderedDict(a=np.float32(1.5), b={1, 2}, c=np.str_("x")), protocol=2))
    assert read_pickle(path) == {"a": 1.5, "b": {1, 2}, "c": "x"}


@pytest.mark.parametrize("kind", [scipy.sparse.csc_matrix, scipy.sparse.csr_matrix])
def test_sparse_matrices_come_back_dense(tmp_path: Path, kind: type) -> None:
    dense = np.arange(12.0).reshape(3, 4) * (np.arange(12).reshape(3, 4) % 3 == 0)
    path = tmp_path / "model.pkl"
    path.write_bytes(pickle.dumps(kind(dense), protocol=2))
    assert (read_pickle(path) == dense).all()


def test_a_sparse_matrix_pointing_outside_is_refused(tmp_path: Path) -> None:
    matrix = scipy.sparse.csc_matrix(np.eye(3))
    matrix.indices[1] = 1000
    path = tmp_path / "model.pkl"
    path.write_bytes(pickle.dumps(matrix))
    with pytest.raises(DatasetError, match="damaged"):
        read_pickle(path)


def test_an_array_that_claims_more_than_its_bytes_is_refused(tmp_path: Path) -> None:
    blob = pickle.dumps(np.zeros(5), protocol=2)
    path = tmp_path / "fit.pkl"
    path.write_bytes(blob.replace(b"K\x05\x85", b"K\x7f\x85"))
    with pytest.raises(DatasetError, match=r"shape \(127,\)"):
        read_pickle(path)


def test_python_objects_in_arrays_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "fit.pkl"
    path.write_bytes(pickle.dumps(np.array([{}], dtype=object)))
    with pytest.raises(DatasetError, match="Python objects"):
        read_pickle(path)


def _chumpy(name: str, state: bytes) -> bytes:
    return b"\x80\x02cchumpy.%s\n)\x81" % name.encode() + state + b"b."


def test_chumpy_arrays_give_their_values_without_chumpy(tmp_path: Path) -> None:
    inner = pickle.dumps({"x": np.arange(6.0)}, protocol=2)[2:-1]
    path = tmp_path / "model.pkl"
    path.write_bytes(_chumpy("ch\nCh", inner))
    assert (read_pickle(path) == np.arange(6.0)).all()
    selected = pickle.dumps({"a": np.arange(6.0), "idxs": np.array([4, 1]), "preferred_shape": (2, 1)}, protocol=2)
    path.write_bytes(_chumpy("reordering\nSelect", selected[2:-1]))
    assert read_pickle(path).tolist() == [[4.0], [1.0]]


def test_chumpy_expressions_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "model.pkl"
    path.write_bytes(_chumpy("ch_ops\nadd", pickle.dumps({"left": 1}, protocol=2)[2:-1]))
    with pytest.raises(DatasetError, match=r"chumpy\.ch_ops\.add.*re-save"):
        read_pickle(path)


def test_a_container_inside_itself_is_refused(tmp_path: Path) -> None:
    loop: list[object] = []
    loop.append(loop)
    path = tmp_path / "fit.pkl"
    path.write_bytes(pickle.dumps(loop))
    with pytest.raises(DatasetError, match="contains itself"):
        read_pickle(path)


def test_a_file_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "fit.pkl"
    path.write_bytes(b"x" * 100)
    with pytest.raises(DatasetError, match="100 bytes, at most 10"):
        read_pickle(path, max_bytes=10)


@given(garbage=st.binary(max_size=60))
def test_garbage_always_ends_in_a_dataset_error_or_plain_content(
    tmp_path_factory: pytest.TempPathFactory, garbage: bytes
) -> None:
    path = tmp_path_factory.mktemp("pickle") / "fit.pkl"
    path.write_bytes(garbage)
    try:
        read_pickle(path)
    except DatasetError as error:
        assert "fit.pkl" in str(error)
