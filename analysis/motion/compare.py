"""Motion priors and real clips, measured alike."""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from hoi.body.kinematics import joint_positions
from hoi.body.skeleton import PARENTS
from hoi.errors import InputError
from hoi.motion.evaluator import SHIPPED, Evaluator, load_evaluator
from hoi.motion.features import decode, encode
from hoi.motion.prior import load_prior
from hoi.training.motion.dataset import FPS, TrainingSet
from hoi.training.motion.training import read_split

from . import measures, sources
from .measures import LIMBS
from .sources import Case, Source

REAL = "held-out clips"


@dataclass(frozen=True)
class Answers:
    """A source's motions."""

    raw: Tensor
    """Features as the source gave them, (N, 40, 205)."""
    joints: Tensor
    """Of the decoded motion [m], (N, 40, 24, 3)."""
    embeddings: Tensor
    """Of the decoded motion, (N, D)."""


def answers_of(raw: Tensor, evaluator: Evaluator, rest_joints: Tensor) -> Answers:
    """Decode, as at run time, and encode again, so that all are judged by what they look like."""
    motion = decode(raw)
    joints = joint_positions(*motion, rest_joints)
    return Answers(raw, joints, evaluator.embed_motion(encode(*motion, rest_joints)))


def measured(
    cases: Sequence[Case], given: Answers, truth: Answers, sentences: Tensor, rest_joints: Tensor
) -> dict[str, float]:
    """One row of the table of held-out sentences."""
    rank = measures.ranks(given.embeddings, sentences).numpy()
    labels = np.array([case.label for case in cases])
    worst = max(
        measures.frechet_distance(given.embeddings[labels == label], truth.embeddings[labels == label])
        for label in np.unique(labels)
    )
    parents = list(PARENTS[1:])
    lengths = (given.joints[..., 1:, :] - given.joints[..., parents, :]).norm(dim=-1)
    rest = (rest_joints[1:] - rest_joints[parents]).norm(dim=-1)
    told = given.raw[..., 136:].unflatten(-1, (23, 3))
    again = encode(*decode(given.raw), rest_joints)[..., 136:].unflatten(-1, (23, 3))
    jerks = [measures.jerk(answers.joints, FPS).mean() for answers in (given, truth)]
    return {
        **{f"R@{k}": float((rank < k).mean()) for k in (1, 2, 3)},
        "FID": measures.frechet_distance(given.embeddings, truth.embeddings),
        "worst FID": worst,
        "diversity": measures.diversity(given.embeddings, torch.Generator().manual_seed(0)),
        "skating [m/s]": float(measures.skating(given.joints, FPS).nanmean()),
        "ground [cm]": 100 * float(measures.ground_error(given.joints).mean()),
        "jerk": float(jerks[0] / jerks[1]),
        "mismatch [mm]": 1000 * float((told - again).norm(dim=-1).mean()),
        "bones": float((lengths / rest - 1).abs().max()),
    }


def strikes_measured(cases: Sequence[Case], given: Answers) -> list[dict[str, object]]:
    """Rows of the table of strikes, one a label."""
    rows: list[dict[str, object]] = []
    skating = measures.skating(given.joints, FPS)
    for label in LIMBS:
        speed, named, slide = [], [], []
        for row, case in enumerate(cases):
            if case.label == label:
                one = given.joints[row : row + 1]
                speed.append(float(measures.strike_speed(one, label, case.side, FPS)))
                named.append(bool(measures.strikes_as_named(one, label, case.side, FPS)))
                slide.append(float(skating[row]))
        low, middle, high = np.quantile(speed, (0.1, 0.5, 0.9))
        rows.append(
            {"strike": label, "n": len(speed), "named limb": np.mean(named), "speed [m/s]": middle, "10 %": low,
             "90 %": high, "skating [m/s]": np.nanmean(slide)}
        )  # fmt: skip
    return rows


def study(options: argparse.Namespace) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Both tables.

    Raises:
        InputError: too few motions for a distribution, or the data, evaluator or a prior cannot be read.
    """
    if options.each < 2 or options.strikes < 2:
        raise InputError(f"--each {options.each}, --strikes {options.strikes}: must be at least 2")
    training, held_out = read_split(options.data)
    evaluator = load_evaluator(options.evaluator or SHIPPED)
    everything = _together(training, held_out)
    told = sources.held_out_cases(held_out, set(training.kinds), options.each, options.seed)
    strikes = sources.strike_cases(everything, options.strikes, options.seed)
    sentences = _pools(told, evaluator)
    rest = training.rest_joints
    truth = answers_of(sources.real(held_out)(told), evaluator, rest)
    retrieval = sources.nearest_sentence(training, evaluator.text_encoder.embed, options.seed)
    rows: dict[str, tuple[Source, Source]] = {
        REAL: (sources.another(held_out, options.seed), sources.real(everything)),
        "retrieval": (retrieval, retrieval),
    }
    for folder in [None, *(options.prior or [])]:
        prior = load_prior(folder)
        for guidance in options.guidance:
            drawn = options.sampler, options.steps, guidance, options.rescale
            source = sources.drawn_from(prior, *drawn, options.seed)
            name = "shipped prior" if folder is None else folder.name
            said = f"{name}, {options.sampler} {options.steps}, guidance {guidance:g}"
            rows[said + (f", rescale {options.rescale:g}" if options.rescale else "")] = source, source
    table, limbs = [], []
    for name, (answer, strike) in rows.items():
        begin = time.perf_counter()
        given = answers_of(answer(told), evaluator, rest)
        numbers = measured(told, given, truth, sentences, rest)
        struck = strikes_measured(strikes, answers_of(strike(strikes), evaluator, rest))
        print(f"{name}: {time.perf_counter() - begin:.0f} s", file=sys.stderr)
        table.append({"motions": name, "n": len(told), **numbers})
        limbs += [{"motions": "real clips" if name == REAL else name, **row} for row in struck]
    return pd.DataFrame(table), pd.DataFrame(limbs)


def _together(training: TrainingSet, held_out: TrainingSet) -> TrainingSet:
    """Both sets, as one to draw real clips from; weights no longer count."""
    shift = len(training.captions)
    return TrainingSet(
        torch.cat([training.features, held_out.features]),
        torch.cat([training.weights, held_out.weights]) / 2,
        training.caption_choices + [[shift + row for row in rows] for rows in held_out.caption_choices],
        training.captions + held_out.captions,
        training.kinds + held_out.kinds,
        training.rest_joints,
        training.summary,
    )


def _pools(cases: Sequence[Case], evaluator: Evaluator) -> Tensor:
    """Embeddings of each case's sentence and of the others in its pool, (N, 32, D)."""
    pools = [(case.caption, *case.others) for case in cases]
    known = sorted({sentence for pool in pools for sentence in pool})
    rows = {sentence: row for row, sentence in enumerate(known)}
    return evaluator.embed_text(known)[torch.tensor([[rows[sentence] for sentence in pool] for pool in pools])]
