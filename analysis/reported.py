"""What the paper reports of itself and others, for a block of its own beside what is measured here.

Its scenes, weights, videos and raters are not ours: the numbers say what was reported, not what a rerun gives.
Sources: the tables Quantitative Evaluation and Ablation Study, and Implementation Details for the time (74 minutes a
scene on one H200, of which Video-SDS takes about an hour).
"""

import pandas as pd

from .study import questions

QUESTIONS = {question.key.lower(): f"{question.key} {question.title.lower()}" for question in questions.QUESTIONS}
"""The user study's questions, mean opinion scores from 1 to 5; higher is better."""

_COLUMNS = ("table", "method", "variant", "vqa_yes", "viclip", *QUESTIONS)
_BASELINES, _ABLATIONS = "Quantitative Evaluation", "Ablation Study"
_ROWS = (
    (_BASELINES, "4D-fy", "4D-fy", 0.15, 0.26, 1.42, 1.44, 1.85, 1.76),
    (_BASELINES, "AnimateAnyMesh", "AnimateAnyMesh", 0.19, 0.24, 1.61, 1.51, 2.40, 2.11),
    (_BASELINES, "PhyGenHOI", "full", 0.25, 0.30, 4.33, 4.29, 4.21, 4.04),
    (_ABLATIONS, "PhyGenHOI", "full", 0.25, 0.30, 4.41, 4.44, 4.25, 4.15),
    (_ABLATIONS, "w/o Attraction", "no_attraction", 0.24, 0.23, 2.46, 1.85, 2.97, 2.83),
    (_ABLATIONS, "w/o Contact", "no_contact", 0.20, 0.23, 1.92, 1.61, 2.83, 2.55),
    (_ABLATIONS, "w/o MDM", "no_mdm", 0.20, 0.22, 3.26, 2.82, 1.85, 2.65),
    (_ABLATIONS, "w/o MPM", "no_mpm", 0.21, 0.23, 3.04, 3.58, 3.65, 3.56),
    (_ABLATIONS, "w/o Video-SDS", "no_video_sds", 0.25, 0.27, 4.13, 4.15, 4.11, 3.75),
)
SECONDS = {"full": 74 * 60.0}
"""Wall-clock time of a scene, by variant."""


def reported() -> pd.DataFrame:
    """The rows the paper reports: table, method, variant (ours of the same name), scores, seconds."""
    rows = pd.DataFrame(_ROWS, columns=list(_COLUMNS))
    return rows.assign(seconds=[SECONDS.get(row[2], float("nan")) for row in _ROWS])
