"""What stage 2 does to motions: `python -m analysis.strikes [-o FOLDER] [--seeds N] [overrides]`.

Ten strikes, each with an object where it can be struck, from a sample of the prior and from the standing pose; several
seeds as one batch. Stages 1 and 2 only: the object stays where it is. Writes strikes.csv, strikes.md and strikes.npz,
the joints after stage 2. Exit codes: 0 done; 2 bad input; 3 a stage failed.

    strange   distance to the nearest real motion by the evaluator's embedding: 0 to 2
    aligned   the evaluator's likeness of motion and sentence: -1 to 1
    named     share in which the limb that the sentence names is the one that strikes
    speed     peak of that limb
    skating   mean horizontal speed of a toe below 5 cm
    jerk      mean size of the joints' third derivative
    gap       of the striking joint's skin to the object at t*
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hoi.config.compose import config_of
from hoi.data import Motion
from hoi.terminal.program import program

from . import command, sheets

if TYPE_CHECKING:
    import pandas as pd

    from hoi.method.hmsd import ScoreDistillation
    from hoi.motion.evaluator import Evaluator


@dataclass(frozen=True)
class Strike:
    """One sentence, the limb that it names, and where the object is."""

    label: str
    side: str
    limb: str
    sentence: str
    position: str


STRIKES = (
    Strike("kick_soccer", "right", "right_foot", "a person runs up and kicks a soccer ball with the right foot",
           "[0,1.2,null]"),
    Strike("kick_front", "left", "left_foot", "a person does a front kick with the left leg", "[0,1.0,0.7]"),
    Strike("kick_front", "right", "right_foot", "a person does a front kick with the right leg", "[0,1.0,0.7]"),
    Strike("kick_side", "right", "right_foot", "a person does a side kick with the right leg", "[0,1.0,0.8]"),
    Strike("kick_spin", "right", "right_foot", "a person does a spinning kick with the right leg", "[0,1.0,0.8]"),
    Strike("punch", "right", "right_hand", "a person throws a right punch", "[0,0.8,1.3]"),
    Strike("punch_jab", "left", "left_hand", "a person throws a left jab", "[0,0.8,1.3]"),
    Strike("punch_slow", "right", "right_hand", "a person slowly punches with the right hand", "[0,0.8,1.2]"),
    Strike("push", "", "hands", "a person pushes a box with both hands", "[0,0.8,1.1]"),
    Strike("karate_knee", "right", "right_knee", "a person does a knee strike with the right knee", "[0,0.7,0.65]"),
)  # fmt: skip


def judged(
    strike: Strike, motions: Sequence[Motion], distillation: ScoreDistillation, evaluator: Evaluator
) -> dict[str, float]:
    """Medians over the seeds, and the share of strikes with the named limb; on the prior's own skeleton."""
    import torch

    from hoi.method.pose import PoseParameters

    from .motion import measures

    pose = PoseParameters.of(motions)
    with torch.no_grad():
        features = distillation.prior.denormalise(distillation.features(pose))
        rest = distillation.prior.rest_joints
        joints = pose.joints(rest)
        joints = joints + (pose.translation * (distillation.leg_ratio - 1))[..., None, :]
        joints[..., 2] -= distillation.sole_height * distillation.leg_ratio
    fps = motions[0].fps
    likeness = evaluator.embed_motion(features) @ evaluator.embed_text([strike.sentence])[0]
    return {
        "strange": float(evaluator.strangeness(features).median()),
        "aligned": float(likeness.median()),
        "named": float(measures.strikes_as_named(joints, strike.label, strike.side, fps).double().mean()),
        "speed [m/s]": float(measures.strike_speed(joints, strike.label, strike.side, fps).median()),
        "skating [m/s]": float(measures.skating(joints, fps).nanmedian()),
        "jerk [m/s^3]": float(measures.jerk(joints, fps).median()),
    }


def study(overrides: Sequence[str], seeds: Sequence[int], inits: Sequence[str]) -> tuple[pd.DataFrame, dict]:
    """One row a strike, a start and a stage; and the joints after stage 2 [m], (seeds, T, 24, 3), by "start/number".

    Raises:
        InputError: a bad override, or one that leaves the motion prior out.
        RunError: a stage failed.
    """
    import pandas as pd

    from hoi.body.skinning import joint_paths
    from hoi.motion.evaluator import load_evaluator

    from .reach import first_stage

    evaluator, rows, paths = load_evaluator(), [], {}
    for init in inits:
        for number, strike in enumerate(STRIKES):
            own = (f"scene.motion_prompt={strike.sentence}", f"scene.placement.position={strike.position}")
            limb = f"scene.striking_limb={strike.limb}"
            start = f"++stage.motion.init={init}"
            config = config_of("render=none", "human.gaussians=8000", *own, limb, *overrides, start)
            walk = first_stage("analysis.strikes", config, seeds)
            scene, distillation = walk.batch.scenes[0], walk.distillation
            assert distillation is not None
            free = [state.motion for state in walk.states if state.motion is not None]
            walk.coordinate()
            after = [state.motion for state in walk.states if state.motion is not None]
            facts_of_it = {"start": init, "strike": strike.sentence, "n": len(seeds)}
            rows.append({**facts_of_it, "stage": 1, **judged(strike, free, distillation, evaluator)})
            gap = float(np.median([stages.reports[-1].numbers.get("reach_gap", np.nan) for stages in walk.stages]))
            numbers = judged(strike, after, distillation, evaluator)
            rows.append({**facts_of_it, "stage": 2, **numbers, "gap [m]": gap})
            paths[f"{init}/{number}"] = np.stack([joint_paths(scene.body, motion) for motion in after])
            print(f"{init}: {strike.sentence}", file=sys.stderr)
    return pd.DataFrame(rows), paths


@command.exit_code("analysis.strikes")
def main() -> None:
    parser = command.parser(
        "analysis.strikes",
        "What stage 2 does to motions: ten strikes, before and after, by evaluator and joints.",
        "-o runs/strikes --seeds 10",
    )
    parser.add_argument("-o", "--out", type=Path, default=Path("runs/strikes"), help="folder for the tables")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--start", choices=("sample", "stand"), action="append", help="default: both")
    parser.add_argument("overrides", nargs="*", help="config overrides, as for hoi.run")
    options = parser.parse_args()
    import torch

    table, paths = study(options.overrides, range(max(options.seeds, 1)), options.start or ["sample", "stand"])
    options.out.mkdir(parents=True, exist_ok=True)
    noted = sheets.facts(torch.get_num_threads())
    table.assign(**noted).to_csv(options.out / "strikes.csv", index=False)
    np.savez_compressed(options.out / "strikes.npz", **paths)
    rows = sheets.markdown_table(table.to_dict("records"))
    text = sheets.markdown(["# What stage 2 does to motions", sheets.markdown_list(noted), rows])
    (options.out / "strikes.md").write_text(text, encoding="utf-8")
    print(options.out / "strikes.md")


if __name__ == "__main__":
    program(main)
