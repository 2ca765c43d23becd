"""Inertials spoiled by known mistakes come back to their digits."""

import numpy as np
import pytest

from consistent_id import ModelError
from consistent_id.repair import repair_urdf
from consistent_id.repair.causes import candidates, shifted
from consistent_id.repair.link_evidence import hull_solid

ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
# Link 1 of the left RealMan RX75-6FB, as its maker published it: izz lacks a decimal
# point, the arm on the right has 1662E-6.
RX75 = ("2661.9E-6", "-31.029E-6", "9.34E-6", "2302.5E-6", "151.466E-6", "1676359E-6")


def _link(name, mass, com, entries, rpy="0 0 0", shape=""):
    inertia = " ".join(f'{k}="{v}"' for k, v in zip(ENTRIES, entries, strict=True))
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}" rpy="{rpy}"/>'
        f'<mass value="{mass}"/><inertia {inertia}/></inertial>{shape}</link>'
    )


def _box(x, y, z, com="0 0 0"):
    box = f'<geometry><box size="{x} {y} {z}"/></geometry>'
    return f'<visual><origin xyz="{com}"/>{box}</visual>'


@pytest.fixture
def repaired(tmp_path):
    """Repair a robot of links, and return the repair."""

    def repair(*links, **options):
        path = tmp_path / "robot.urdf"
        path.write_text(f'<robot name="r">{"".join(links)}</robot>')
        return repair_urdf(path, **options)

    return repair


def test_the_decimal_slip_of_a_published_arm_is_found(repaired):
    com = "0.488E-3 -13.727E-3 -10.765E-3"
    repair = repaired(_link("link1", 1.559, com, RX75))
    (link,) = repair.repaired
    assert link.remedy == "izz is 1000 times too large"
    assert b'izz="0.001676359"' in repair.content
    assert repair.original.replace(b"1676359E-6", b"0.001676359") == repair.content


def test_a_sign_is_found_by_the_other_legs(repaired):
    """Numbers made up: a hip whose three products have one sign wrong."""
    good = (0.0010, -0.0004, 0.0003, 0.0010, 0.0004, 0.0009)
    legs = [
        _link(f"hip{k}", 0.7, com, signed)
        for k, (com, signed) in enumerate(
            [
                ("-0.02 0.01 0.03", good),
                ("0.02 0.01 0.03", (0.0010, 0.0004, -0.0003, 0.0010, 0.0004, 0.0009)),
                ("-0.02 -0.01 0.03", (0.0010, 0.0004, 0.0003, 0.0010, -0.0004, 0.0009)),
            ]
        )
    ]
    bad = (0.0010, -0.0004, 0.0003, 0.0010, -0.0004, 0.0009)
    repair = repaired(_link("hip", 0.7, "-0.02 0.01 0.03", bad), *legs)
    (link,) = repair.repaired
    assert link.remedy == "the sign of iyz is wrong"
    assert b'iyz="0.0004"' in repair.content


@pytest.mark.parametrize(
    ("written", "cause"),
    [
        ((0.021, 0.0004, 0.017, -0.0008, 0.0003, 0.009), "lower triangle"),
        ((0.021, 0.017, 0.009, 0.0004, -0.0008, 0.0003), "diagonal was written first"),
    ],
)
def test_entries_in_another_order_are_put_back(repaired, written, cause):
    """Numbers made up; the order is that of a published humanoid's arm."""
    shape = _box(0.11, 0.16, 0.26)
    repair = repaired(_link("arm", 3.0, "0 0 0", written, shape=shape))
    (link,) = repair.repaired
    assert cause in link.remedy
    expected = dict(
        zip(ENTRIES, (0.021, 0.0004, -0.0008, 0.017, 0.0003, 0.009), strict=True)
    )
    for entry, value in expected.items():
        assert f'{entry}="{value}"'.encode() in repair.content


def test_a_negative_moment_had_a_wrong_sign(repaired):
    repair = repaired(_link("a", 1.0, "0 0 0", (0.02, 0, 0, 0.03, 0, -0.025)))
    assert repair.repaired[0].remedy == "the sign of izz is wrong"


def test_an_ambiguous_cause_is_listed_and_chosen(repaired):
    """A rod of which one moment slipped: it may be either of the two equal ones."""
    rod = _link("rod", 20.0, "0 0 0", (0.2, 0, 0, 0.022, 0, 2.0))
    repair = repaired(rod)
    (link,) = repair.refused
    assert "several mistakes explain it" in link.remedy
    causes = [one.cause for one in link.suggestions]
    assert {"izz is 10 times too large", "ixx is 10 times too small"} <= set(causes)
    with pytest.raises(ModelError, match="several mistakes"):
        repair.save("nowhere.urdf")
    place = causes.index("izz is 10 times too large") + 1
    assert b'izz="0.2"' in repaired(rod, choices={"rod": place}).content
    nearest = repaired(rod, choices={"rod": 0})
    assert "nearest" in nearest.repaired[0].remedy
    assert "moves the second moments by" in nearest.repaired[0].warning
    with pytest.raises(ModelError, match="choice 9, but there are"):
        repaired(rod, choices={"rod": 9})
    with pytest.raises(ModelError, match="no link 'rot'"):
        repaired(rod, choices={"rot": 1})


def test_shapes_decide_between_causes(repaired):
    long = _box(0.08, 0.34, 0.08)
    rod = _link("rod", 1.0, "0 0 0", (0.01, 0, 0, 0.0011, 0, 0.1), shape=long)
    assert repaired(rod).repaired[0].remedy == "izz is 10 times too large"


def test_units_of_a_consistent_inertia_are_doubted_and_left_alone(repaired):
    """A brick of 2 kg, its inertia in kg mm^2."""
    sides = np.array([0.1, 0.2, 0.3])
    moments = 2.0 / 12.0 * (sides @ sides - sides**2) * 1e6
    brick = _link(
        "brick", 2.0, "0 0 0", (moments[0], 0, 0, moments[1], 0, moments[2]),
        shape=_box(*sides),
    )  # fmt: skip
    repair = repaired(brick)
    (link,) = repair.doubtful
    assert repair.content == repair.original
    assert "1e+06 times too large" in link.remedy
    (chosen,) = repaired(brick, choices={"brick": 1}).repaired
    assert np.allclose(sorted(chosen.after), sorted(moments * 1e-6), rtol=1e-12)


@pytest.mark.parametrize(
    ("mass", "scale", "word"),
    [
        (2.0, 1e6, "the inertia is 1e+06 times too large"),
        (2000.0, 1.0, "the mass is 1000 times too large"),
        (2000.0, 1e9, "the mass is in grams, the inertia 1e+09 times too large"),
        (2.0, 1.0, ""),
    ],
)
def test_units_of_a_whole_file_are_doubted_though_twins_agree(
    repaired, mass, scale, word
):
    """Two bricks of 2 kg, on the left and on the right, and one in the middle."""
    sides = np.array([0.1, 0.2, 0.3])
    I = 2.0 / 12.0 * (sides @ sides - sides**2) * scale  # noqa: E741
    bricks = [
        _link(name, mass, com, (I[0], 0, 0, I[1], 0, I[2]), shape=_box(*sides, com=com))
        for name, com in [("a", "0 0.3 0.1"), ("b", "0 -0.3 0.1"), ("c", "0 0 0.2")]
    ]
    doubtful = repaired(*bricks).doubtful
    assert [link.link for link in doubtful] == (["a", "b", "c"] if word else [])
    assert all(word in link.remedy for link in doubtful)


@pytest.mark.slow
def test_the_mistakes_undo_what_they_name():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(3, 3))
    inertia = A @ A.T + 3.0 * np.eye(3)
    mass, com = 2.0, rng.normal(size=3)
    axes, _ = np.linalg.qr(A)
    axes *= np.linalg.det(axes)
    c = axes.T @ com
    about_origin = inertia + mass * (c @ c * np.eye(3) - np.outer(c, c))
    spoiled = {
        "about the link's origin": about_origin,
        "in the link's axes": axes @ inertia @ axes.T,
        "transpose": axes @ axes @ inertia @ axes.T @ axes.T,
    }
    for words, stated in spoiled.items():
        found = candidates(mass, com, axes, stated)
        (one,) = [one for one in found if words in one.cause]
        assert np.allclose(one.inertia, inertia, rtol=0, atol=1e-12)


def test_a_shifted_point_keeps_the_digits():
    assert shifted(1.676359, -3) == 0.001676359
    assert shifted(0.1 + 0.2, 1) == 3.0000000000000004


def test_the_solid_of_a_box_has_its_volume_and_spread():
    sides = np.array([0.1, 0.2, 0.3])
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    solid = hull_solid(corners * sides + [1.0, 2.0, 3.0])
    assert solid.volume == pytest.approx(0.006)
    assert np.allclose(solid.spread, np.diag(sides**2) / 12.0, rtol=0, atol=1e-12)
    assert hull_solid(corners[:4] * sides) is None
