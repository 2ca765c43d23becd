"""Problem files of small robots in scenes."""

from consistent_id import load_problem

ARM = """
name = "arm"
[model]
modified_dh = [
    {{ alpha_deg = 0.0, a = 0.0, lower = -3.0, upper = 3.0, velocity = 2.0 }},
    {{ alpha_deg = 90.0, a = 0.0, lower = -1.5, upper = 1.5, velocity = 2.0 }},
    {{ alpha_deg = 0.0, a = 0.6, lower = -2.5, upper = 2.5, velocity = 2.0 }},
]
[constraints]
masses = "free"
[excitation]
duration = 6.0
harmonics = 3
refine = "none"
{excitation}
[excitation.limits]
acceleration = 6.0
[excitation.scene]
robot = "bodies"
clearance = 0.01
{scene}
bodies = [
    {{ name = "upper arm", link = "link2", capsule = {{ radius = 0.05, ends = [[0.0, 0.0, 0.0], [0.6, 0.0, 0.0]] }} }},
    {{ name = "forearm", link = "link3", capsule = {{ radius = 0.04, length = 0.5 }}, position = [0.25, 0.0, 0.0], rpy_deg = [0.0, 90.0, 0.0] }},
    {bodies}
]
"""  # noqa: E501
WALL = '{ name = "wall", box = { size = [0.1, 3.0, 3.0] }, position = [0.75, 0, 0] },'

# One joint that lifts an arm past a post which stands in its way at zero.
LEVER = """
name = "lever"
[model]
modified_dh = [
    {{ alpha_deg = 90.0, a = 0.0, lower = -3.0, upper = 3.0, velocity = 2.0 }},
]
[constraints]
masses = "free"
[excitation]
duration = 4.0
harmonics = 2
refine = "none"
{excitation}
[excitation.limits]
acceleration = 6.0
[excitation.scene]
robot = "bodies"
bodies = [
    {{ name = "arm", link = "link1", capsule = {{ radius = 0.02, ends = [[0.1, 0.0, 0.0], [0.6, 0.0, 0.0]] }} }},
    {{ name = "post", cylinder = {{ radius = 0.05, length = 1.0 }}, position = [0.5, 0.0, 0.0], rpy_deg = [90.0, 0.0, 0.0] }},
]
"""  # noqa: E501


def scene_problem(folder, text, **parts):
    """A problem of a text whose parts are filled in, written into a folder."""
    defaults = {"excitation": "", "scene": "", "bodies": ""}
    (folder / "problem.toml").write_text(text.format(**defaults | parts))
    return load_problem(folder, trust=True)
