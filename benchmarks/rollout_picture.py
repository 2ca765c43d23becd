"""The pictures of ``docs/rollout.md``.

``python benchmarks/rollout_picture.py [FOLDER] [--write PAGE]``

Of ``problems/unitree_go2``: what a calf of the validation log was told and did, and
what the torque fit, its refinement and the robot's shipped file do when they are told
the same; and the errors of all joints.  The folder is that of the
page, or ``docs``; recordings
are found through ``CONSISTENT_ID_DATASETS``.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib import pyplot
from pages import add_write, shown_on

import consistent_id as ci
from consistent_id.rollout import Replay, rollout
from consistent_id.rollout.refine import refined
from consistent_id.rollout.settings import gains_of, torque_fit

JOINT = "RL_calf_joint"
SPAN = (18.0, 20.5)  # s
COLOURS = {"identified, refined": "C0", "torque fit": "C2", "shipped, offsets": "C3"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help="for the picture")
    add_write(parser)
    options = parser.parse_args()
    page = options.write or Path("docs/rollout.md")
    replays = replayed(ci.load_problem("problems/unitree_go2"))
    with shown_on(options.write, ["unitree_go2"]):
        print("| replay of the validation log | error [mrad] |\n|---|---:|")
        for name, one in replays.items():
            print(f"| {name} | {1e3 * np.sqrt((one.errors**2).mean()):.2f} |")
    draw(replays, (options.folder or page.parent) / "rollout.png")


def draw(replays: dict[str, Replay], file: Path) -> None:
    """Draw both pictures into a file."""
    figure, axes = pyplot.subplots(1, 2, figsize=(10.0, 3.4), width_ratios=(3, 2))
    motion(axes[0], replays)
    errors(axes[1], replays)
    figure.tight_layout()
    figure.savefig(file, dpi=110)


def replayed(problem: ci.Problem) -> dict[str, Replay]:
    """Return the replays of the validation log by each model."""
    gains, delay = gains_of(problem), problem.delay_of_commands
    training, validation = problem.logs("training"), problem.logs("validation")
    estimate, regression = torque_fit(problem)
    better = refined(
        estimate,
        regression,
        training,
        gains,
        constraints=problem.constraints,
        delay=delay,
    )
    file = problem.model_files["mjcf"]
    found = [
        rollout(
            model, validation, gains, against=against, training=training, delay=delay
        ).offsets
        for model, against in ((better.estimate, [file]), (estimate, []))
    ]
    (own, *_), (shipped, *_) = found[0].values()
    ((fit, *_),) = found[1].values()
    return dict(zip(COLOURS, (own, fit, shipped), strict=True))


def motion(axes: pyplot.Axes, replays: dict[str, Replay]) -> None:
    """Draw what one joint was told, did, and does in simulation."""
    log = next(iter(replays.values())).log
    j = log.joints.index(JOINT)
    seen = (log.time >= SPAN[0]) & (log.time <= SPAN[1])
    time = log.time[seen]
    axes.step(time, log.position_command[seen, j], "0.7", where="post", label="command")
    axes.plot(time, log.position[seen, j], "k", lw=2, label="robot")
    for name, replay in replays.items():
        axes.plot(time, replay.position[seen, j], COLOURS[name], lw=1, label=name)
    axes.set(xlabel="time [s]", ylabel="position [rad]", title=f"{JOINT}, validation")
    axes.legend(fontsize=7, ncol=5, loc="upper center", bbox_to_anchor=(0.5, -0.2))


def errors(axes: pyplot.Axes, replays: dict[str, Replay]) -> None:
    """Draw the errors of all joints."""
    joints = next(iter(replays.values())).log.joints
    places = np.arange(len(joints))
    for k, (name, replay) in enumerate(replays.items()):
        axes.barh(places + 0.27 * (k - 1), 1e3 * replay.rmse, 0.27, color=COLOURS[name])
    axes.set_yticks(places, [joint.removesuffix("_joint") for joint in joints], size=7)
    axes.invert_yaxis()
    axes.set(xlabel="error of position [mrad]", title="closed-loop replay, 15 to 23 s")


if __name__ == "__main__":
    main()
