"""Files of torch.save, read without PyTorch; what else a pickle holds is not run."""

import pickle
import zipfile

import numpy as np
import pytest

from consistent_id import RecordingError
from consistent_id.recordings.readers import pytorch

FLOAT = b"ctorch\nFloatStorage\n"
REBUILD = b"ctorch._utils\n_rebuild_tensor_v2\n"
SIX = np.arange(6, dtype="<f4").tobytes()
END = b"\x89ccollections\nOrderedDict\n)RtR"
# Tuples of the one before, twice: 2^24 numbers in some 120 bytes.
TWICE_EACH = b"K\x01q\x00" + b"".join(
    b"h" + bytes([k]) + b"h" + bytes([k]) + b"\x86q" + bytes([k + 1]) for k in range(24)
)


def tensor(shape, strides, count, kind=FLOAT):
    """Return the pickle of a tensor as protocol 2 of torch.save has it."""

    def numbers(values):
        return b"(" + b"".join(b"K" + bytes([v]) for v in values) + b"t"

    head = (
        b"((X\x07\x00\x00\x00storage" + kind + b"X\x01\x00\x00\x000X\x03\x00\x00\x00cpu"
    )
    place = b"K" + bytes([count]) + b"tQ"
    return REBUILD + head + place + b"K\x00" + numbers(shape) + numbers(strides) + END


def saved(folder, body, data=SIX):
    path = folder / "log.pt"
    with zipfile.ZipFile(path, "w") as members:
        members.writestr("log/data.pkl", b"\x80\x02" + body + b".")
        members.writestr("log/data/0", data)
    return path


def test_tensors_of_nested_dictionaries_are_named_by_their_path(tmp_path):
    inner = b"}X\x01\x00\x00\x00q" + tensor((2, 3), (3, 1), 6) + b"s"
    path = saved(tmp_path, b"}X\x03\x00\x00\x00run" + inner + b"s")
    assert pytorch.array_names(path) == ("run.q",)
    read = pytorch.read_arrays(path, ["run.q"])["run.q"]
    np.testing.assert_array_equal(read, [[0, 1, 2], [3, 4, 5]])


def test_a_transposed_tensor_has_its_strides(tmp_path):
    path = saved(tmp_path, tensor((3, 2), (1, 3), 6))
    read = pytorch.read_arrays(path, ["tensor"])["tensor"]
    np.testing.assert_array_equal(read, [[0, 3], [1, 4], [2, 5]])


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (tensor((9, 9), (9, 1), 6), "larger than its storage"),
        (tensor((2, 3), (3, 1), 7), "has 6 numbers, not 7"),
        (tensor((255,) * 4, (0,) * 4, 6), "MiB of data, expected at most"),
        (tensor((2, 3), (3, 1), 6).replace(b"K\x02", b")", 1), "no numbers"),
        (TWICE_EACH + b"h\x18)R", "not a function"),
        (b"}" + TWICE_EACH + b"h\x18K\x01s", "a key that is no name"),
        (TWICE_EACH + b"h\x18", "contain each other too often"),
        (b"cos\nsystem\nX\x04\x00\x00\x00true\x85R", "it holds a os.system"),
        (pickle.dumps(print)[2:-1], "it holds the operation"),
        (tensor((6,), (1,), 6, b"cos\nsystem\n"), "it holds a os.system"),
        (b"}(K\x01u", "not readable"),
        (b"t", "not readable"),
    ],
    ids=[
        *("beyond", "cut", "spread", "shape", "called", "key", "nested"),
        *("call", "function", "kind", "pairs", "mark"),
    ],
)
def test_what_is_no_tensor_is_refused(tmp_path, body, said):
    with pytest.raises(RecordingError, match=said):
        pytorch.array_names(saved(tmp_path, body))


def test_two_tensors_may_be_parts_of_one_storage(tmp_path):
    parts = b"(X\x01\x00\x00\x00a" + tensor((6,), (1,), 6)
    parts += b"X\x01\x00\x00\x00b" + tensor((2, 2), (3, 1), 6) + b"u"
    numbers = np.arange(30_000, dtype="<f4").tobytes()
    path = saved(tmp_path, b"}" + parts)
    read = pytorch.read_arrays(path, ["a", "b"])
    np.testing.assert_array_equal(read["b"], [[0, 1], [3, 4]])
    whole = tensor((200, 150), (150, 1), 48).replace(b"K\x30", b"M\x30\x75")
    whole = whole.replace(b"K\xc8", b"M\xc8\x00")
    path = saved(tmp_path, b"(" + whole + whole + b"t", numbers)
    assert pytorch.array_names(path) == ("0", "1")


def test_a_storage_is_read_once(tmp_path, monkeypatch):
    reads = []
    kept = zipfile.ZipFile.read

    def read(members, name):
        reads.append(name)
        return kept(members, name)

    monkeypatch.setattr(zipfile.ZipFile, "read", read)
    one = tensor((6,), (1,), 6)
    pytorch.array_names(saved(tmp_path, b"(" + one * 5 + b"t"))
    assert reads.count("log/data/0") == 1


def test_big_endian_numbers_are_refused(tmp_path):
    path = saved(tmp_path, tensor((6,), (1,), 6))
    with zipfile.ZipFile(path, "a") as members:
        members.writestr("log/byteorder", "big")
    with pytest.raises(RecordingError, match="big-endian"):
        pytorch.array_names(path)


def test_a_file_that_is_no_archive_is_refused(tmp_path):
    path = tmp_path / "log.pt"
    path.write_bytes(b"\x80\x02}.")
    with pytest.raises(RecordingError, match="not readable as tensors"):
        pytorch.array_names(path)
