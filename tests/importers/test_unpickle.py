"""Arrays out of pickles: what SMPL's files hold is read, and nothing is executed."""

import os
import pickle
import pickletools

import numpy as np
import pytest
from scipy import sparse
from smpl_files import make_model, pickle_model

from hoi.errors import InputError
from hoi.importers.unpickle import read_arrays

KEYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")


@pytest.mark.parametrize("protocol", [0, 1, 2])
@pytest.mark.parametrize("chumpy", [True, False])
def test_reads_what_python_2_wrote(tmp_path, protocol, chumpy):
    model = make_model()
    path = pickle_model(tmp_path / "model.pkl", model, protocol, chumpy)
    names = {argument for opcode, argument, _ in pickletools.genops(path.read_bytes()) if opcode.name == "GLOBAL"}
    assert ("chumpy.ch Ch" in names) == chumpy and "scipy.sparse.csc csc_matrix" in names
    arrays = read_arrays(path, [*KEYS, "no_such_key"])
    assert set(arrays) == set(KEYS)
    for key, array in arrays.items():
        np.testing.assert_array_equal(array, model[key])
        assert array.dtype == model[key].dtype


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_reads_what_todays_numpy_and_scipy_write(tmp_path, protocol):
    rng = np.random.default_rng(0)
    dense = rng.normal(size=(5, 7)) * (rng.uniform(size=(5, 7)) < 0.3)
    values = {
        "fortran": np.asfortranarray(rng.normal(size=(3, 4))),
        "big_endian": rng.normal(size=4).astype(">f8"),
        "single": rng.normal(size=(2, 2)).astype(np.float32),
        "scalar": np.float64(2.5),
        "list": [[1, 2], [3, 4]],
        "empty": np.zeros((0, 3)),
        "sparse": sparse.csc_matrix(dense),
        "sparse_array": sparse.csc_array(dense),
    }
    path = tmp_path / "values.pkl"
    path.write_bytes(pickle.dumps(values, protocol))
    arrays = read_arrays(path, values)
    for key, value in values.items():
        expected = value.toarray() if sparse.issparse(value) else np.asarray(value)
        np.testing.assert_array_equal(arrays[key], expected)


def test_reads_plain_and_pickled_members_of_an_npz(tmp_path):
    model = make_model()
    path = tmp_path / "model.npz"
    np.savez(path, **model | {"J_regressor": np.array(sparse.csc_matrix(model["J_regressor"]), dtype=object)})
    with pytest.raises(ValueError, match="allow_pickle"):
        np.load(path)["J_regressor"]
    arrays = read_arrays(path, KEYS)
    assert set(arrays) == set(KEYS)
    for key, array in arrays.items():
        np.testing.assert_array_equal(array, model[key])


class Calls:
    """Pickles as a call of a function of this process."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def hostile(marker) -> dict[str, bytes]:
    touch = f"touch {marker}"
    code = f"open({str(marker)!r}, 'w')"
    dumps = pickle.dumps
    return {
        "posix.system": dumps({"v_template": Calls(os.system, touch)}),
        "builtins.eval": dumps({"v_template": Calls(eval, code)}),
        "builtins.exec": dumps(Calls(exec, code), 4),
        "os.system": b"cos\nsystem\n(S'" + touch.encode() + b"'\ntR.",
        "numpy.core.multiarray.os.system": b"\x80\x04\x8c\x15numpy.core.multiarray\x8c\x09os.system\x93.",
        "numpy.load": b"cnumpy\nload\n(S'/etc/passwd'\ntR.",
        "builtins.getattr": b"c__builtin__\ngetattr\n.",
        "smplx.body_models.SMPL": b"csmplx.body_models\nSMPL\n.",
    }


NAMES = ("posix.system", "builtins.eval", "builtins.exec", "os.system", "numpy.core.multiarray.os.system")
NAMES += ("numpy.load", "getattr", "smplx.body_models.SMPL")


@pytest.mark.parametrize("index", range(len(NAMES)), ids=NAMES)
def test_anything_else_is_refused_by_name_and_not_run(tmp_path, index):
    marker = tmp_path / "was_here"
    path = tmp_path / "evil.pkl"
    path.write_bytes(list(hostile(marker).values())[index])
    with pytest.raises(InputError) as caught:
        read_arrays(path, ["v_template"])
    message = str(caught.value)
    name = {"builtins.eval": "eval", "builtins.exec": "exec"}.get(NAMES[index], NAMES[index])
    assert str(path) in message and name in message and "refused" in message and "\n" not in message
    assert not marker.exists()


def test_the_allowed_names_are_never_called(tmp_path):
    """Names of chumpy or NumPy lead to no code of theirs, whatever they are given."""
    marker = tmp_path / "was_here"
    path = tmp_path / "evil.pkl"
    path.write_bytes(b"(dS'x'\ncchumpy.os\nsystem\n(S'touch " + str(marker).encode() + b"'\ntRs.")
    with pytest.raises(InputError, match=r"x: a chumpy\.os\.system; only chumpy's Ch and Select"):
        read_arrays(path, ["x"])
    assert not marker.exists()


def test_object_arrays_and_text_are_no_numbers(tmp_path):
    path = tmp_path / "model.pkl"
    for value in (np.array([None, 1], dtype=object), np.array(["a"]), "text", None, {"a": 1}, [1, "b"], [None]):
        path.write_bytes(pickle.dumps({"x": value}))
        with pytest.raises(InputError, match=r"model\.pkl: x: .*must be numbers"):
            read_arrays(path, ["x"])


def test_a_sparse_matrix_cannot_point_outside_itself(tmp_path):
    path = tmp_path / "model.pkl"
    for indices, starts in (([0, 9], [0, 1, 2]), ([0, -1], [0, 1, 2]), ([0, 1], [0, 1]), ([0, 1], [0, 1, 7])):
        matrix = sparse.csc_matrix(np.eye(2))
        matrix.indices, matrix.indptr = np.array(indices, np.int32), np.array(starts, np.int32)
        path.write_bytes(pickle.dumps({"x": matrix}))
        with pytest.raises(InputError, match="x: a sparse matrix"):
            read_arrays(path, ["x"])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "cannot be read"),
        (b"", "neither an .npz nor a whole pickle"),
        (b"not a pickle", "neither an .npz nor a whole pickle"),
        (b"PK\x03\x04broken", "neither an .npz nor a whole pickle"),
        (pickle.dumps([1, 2]), "holds a list; it must be a dictionary"),
    ],
)
def test_other_files(tmp_path, content, words):
    path = tmp_path / "model.pkl"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_arrays(path, KEYS)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", ["pkl", "npz"])
def test_damage_is_an_input_error_or_harmless(tmp_path, suffix):
    """Cut short or with a byte changed, anywhere that is not within an array's numbers."""
    rng = np.random.default_rng(1)
    small = {"v_template": np.zeros((2, 3)), "J_regressor": np.eye(2)}
    path = tmp_path / f"model.{suffix}"
    if suffix == "pkl":
        values = make_model() | small
        pickle_model(path, {key: values[key] for key in ("v_template", "J_regressor")}, chumpy=False)
    else:
        np.savez(path, **small)
    whole = path.read_bytes()
    for round_ in range(400):
        damaged = bytearray(whole)
        if round_ % 4 == 0:
            damaged = damaged[: rng.integers(len(whole))]
        else:
            damaged[rng.integers(len(whole))] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            read_arrays(path, ["v_template", "J_regressor"])
        except InputError as error:
            assert "\n" not in str(error)
