"""How much of its effort limit a joint's friction takes at full speed.

``python benchmarks/friction_shares.py [PROBLEM ...]``: of robots identified from real
recordings; the share that `consistent_id.excitation.verification.FRICTION_SHARE` leaves
where friction is not known.
"""

import sys
from pathlib import Path

import numpy as np

from consistent_id import load_problem
from consistent_id.problems.study import run_study

PROBLEMS = ("ur10e", "staubli_tx40", "tiago")
_HOME = Path(__file__).parent.parent / "problems"


def main(names: list[str]) -> None:
    print("| robot | share of the effort limit, joint by joint | most |")
    print("|---|---|---:|")
    for name in names or PROBLEMS:
        problem = load_problem(_HOME / name)
        model, values = problem.model, run_study(problem).constrained.parameters
        shares = []
        for joint in model.torque_joints:
            place = model.robot.joint_names.index(joint)
            limits = model.robot.driven[place].limits
            own = {
                column.rpartition(".")[2]: abs(value)
                for column, value in zip(model.layout.names, values, strict=True)
                if column.rpartition(".")[0] == joint
            }
            torque = own.get("viscous", 0.0) * limits.velocity
            torque += own.get("coulomb", 0.0)
            shares.append(torque / limits.effort)
        listed = ", ".join(f"{100.0 * share:.0f} %" for share in shares)
        print(f"| {name} | {listed} | {100.0 * np.max(shares):.0f} % |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
