"""Files of one joint, ``elbow``, that are written and refused."""

import pytest

from consistent_id import RecordingError, read_recording


def written(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_bytes(text.encode())
    return path


def refused(tmp_path, text, message, columns=None):
    with pytest.raises(RecordingError, match=rf"log\.csv.*{message}"):
        read_recording(written(tmp_path, text), ["elbow"], columns)
