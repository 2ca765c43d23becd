"""Names of columns in other languages are understood, in whatever encoding."""

import numpy as np
import pytest

from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.column_words import channel_of
from consistent_id.recordings.readers import read_recording

JOINTS = ("axis_a", "axis_b")
TIME = np.arange(40) / 10.0
POSITION = np.column_stack([np.sin(TIME), 0.2 * TIME])
VELOCITY = np.column_stack([np.cos(TIME), 0.2 + 0.0 * TIME])
TORQUE = 3.0 * POSITION + 1.0
TURN = np.degrees(1.0)

LOGS = {
    "German": ("Zeit [s]", "J{} Istposition [Grad]", "J{} Istgeschwindigkeit [Grad/s]"),
    "French": ("temps", "position_axe{}_deg", "vitesse_axe{}_deg_s"),
    "Chinese": ("时间(s)", "关节{}位置(deg)", "关节{}速度(deg/s)"),
    "Japanese": ("時刻[s]", "{}軸位置[deg]", "{}軸速度[deg/s]"),
    "Korean": ("시간(s)", "{}축 위치(deg)", "{}축 속도(deg/s)"),
}
TORQUES = {
    "German": "J{} Motormoment [Nm]",
    "French": "couple_axe{}",
    "Chinese": "关节{}力矩(Nm)",
    "Japanese": "{}軸トルク[Nm]",
    "Korean": "{}축 토크(Nm)",
}
COMMANDS = {"German": "J{} Sollposition [Grad]", "Japanese": "{}軸指令位置[deg]"}


@pytest.mark.parametrize(
    ("language", "encoding"),
    [
        ("German", "utf-8"),
        ("German", "cp1252"),
        ("French", "utf-8"),
        ("Chinese", "utf-8"),
        ("Chinese", "gbk"),
        ("Japanese", "utf-8-sig"),
        ("Japanese", "shift_jis"),
        ("Korean", "euc_kr"),
    ],
)
def test_names_in_other_languages_are_read(tmp_path, language, encoding):
    clock, *motion = LOGS[language]
    blocks = {
        motion[0]: POSITION * TURN,
        motion[1]: VELOCITY * TURN,
        TORQUES[language]: TORQUE,
    }
    if language in COMMANDS:
        blocks[COMMANDS[language]] = 0.0 * POSITION
    header = [clock, *(name.format(k) for name in blocks for k in (1, 2))]
    table = np.column_stack([TIME, *blocks.values()])
    text = "\n".join(
        [",".join(header), *(",".join(map(repr, r)) for r in table.tolist())]
    )
    file = tmp_path / "log.csv"
    file.write_bytes(text.encode(encoding) + b"\n")
    guess = guess_columns(file, KnownColumns(JOINTS))
    log = read_recording(file, guess.joints, guess.columns)
    np.testing.assert_allclose(log.time, TIME)
    np.testing.assert_allclose(log.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(log.velocity, VELOCITY, atol=1e-12)
    np.testing.assert_allclose(log.torque, TORQUE)


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("Winkelgeschwindigkeit_{number}", "velocity"),
        ("Motortemperatur_{number}", ""),
        ("{number}軸加速度", ""),
        ("关节{number}期望速度", ""),
        ("consigne_position_{number}", "position_command"),
        ("omega_{number}", "velocity"),
    ],
)
def test_joined_words_are_told_apart(name, channel):
    assert channel_of(name) == channel


@pytest.mark.parametrize("letters", ["größe", "Öá", "Ãà", "Ž²"])  # 轴, 축, 軸
def test_letters_of_windows_are_no_east_asian_word(tmp_path, letters):
    file = tmp_path / "log.csv"
    rows = "".join(f"{k},{k},{-k},1,2\n" for k in range(5))
    header = f"time,q1 [°],q2 [°],tau1 {letters},tau2 {letters}\n"
    file.write_bytes((header + rows).encode("cp1252"))
    guess = guess_columns(file, KnownColumns(JOINTS))
    assert guess.columns.position == "q{number} [°]"
    assert guess.columns.torque == f"tau{{number}} {letters}"
