"""Each omission both ways, the derived label, and what is refused before anything heavy is imported."""

import subprocess
import sys

import pytest

from hoi.config import CONF
from hoi.config.validate import to_config
from hoi.errors import InputError
from hoi.plan import format_plan, make_plan


@pytest.fixture
def plan(composed):
    return lambda *overrides: make_plan(to_config(composed(*overrides)))


def omitted(plan) -> set[str]:
    return {omission.what for omission in plan.omissions}


@pytest.mark.parametrize(
    ("ablation", "variant", "without"),
    [
        ("full", "full", set()),
        ("no_video_sds", "no_video_sds", {"refine"}),
        ("no_attraction", "no_attraction", {"attraction"}),
        ("no_contact", "no_contact", {"contact"}),
        ("no_mdm", "no_mdm", {"motion"}),
        ("no_mpm", "no_mpm", {"MPM"}),
    ],
)
def test_each_ablation_leaves_out_its_part(plan, ablation, variant, without):
    made = plan(f"ablation={ablation}")
    assert made.variant == variant
    assert without <= omitted(made)
    for part in {"attraction", "contact", "motion", "MPM", "refine"} - without:
        assert part not in omitted(made) or (ablation == "no_contact" and part == "MPM")


def test_label_that_contradicts_the_ablation_is_refused(plan):
    with pytest.raises(InputError, match=r"ablation=no_mpm contradicts .* runs with the MPM"):
        plan("ablation=no_mpm", "stage/object=mpm")


def test_full_claims_nothing(plan):
    assert plan("ablation=full", "stage/object=constant_velocity").variant == "no_mpm"


def test_own_motion_says_where_the_prior_is_used(plan, tmp_path):
    """In stage 2 alone, or nowhere, which is w/o MDM; and that the sentence did not make the motion."""
    file = tmp_path / "walk.bvh"
    file.touch()
    own = ["stage/motion=file", f"stage.motion.path={file}"]
    made = plan(*own)
    (motion,) = [step for step in made.steps if step.name == "motion"]
    assert made.variant == "motion_from_file" and motion.implementation == "file"
    assert str(file) in motion.reason and motion.reason.endswith("used in L_HMSD of stage 2 alone")
    for unused in ("stage.coordinate.lambda_hmsd=0", "stage.coordinate.iterations=0"):
        made = plan(*own, unused)
        assert made.variant.startswith("no_mdm+motion_from_file") and "motion prior" in omitted(made)
    assert "no_mdm" in plan(*own, "stage.coordinate.lambda_hmsd=0", "ablation=no_mdm").variant
    assert "no_mdm" not in plan(*own, "stage.coordinate.lambda_hmsd=0", "stage.motion.iterations=10").variant
    with pytest.raises(InputError, match=r"ablation=no_mdm contradicts .* runs with the motion prior"):
        plan(*own, "ablation=no_mdm")
    (missing,) = plan("stage/motion=file", "stage.motion.path=nowhere.npz").missing
    assert str(missing).startswith("stage.motion.path: no motion file at nowhere.npz; ")


def test_no_weight_on_attraction_is_no_attraction(plan):
    assert "no_attraction" in plan("stage.attraction.lambda_attr=0").variant


@pytest.mark.parametrize(
    ("override", "simulated"),
    [
        ("seed=0", False),
        ("scene.placement.position=[0,2,1]", True),
        ("scene.placement.velocity=[1,0,0]", True),
        ("scene.placement.angular_velocity=[0,0,1]", True),
        ("object.stable=false", True),
        ("stage.object.phases=false", True),
    ],
)
def test_free_motion_of_a_still_object_is_left_out(plan, override, simulated):
    made = plan(override)
    assert made.keeps("free_motion") is simulated
    assert ("free_motion" in omitted(made)) is not simulated


@pytest.mark.parametrize(
    ("overrides", "phases"),
    [
        ([], "mpm, flight, rolling, rest"),
        (["material=sand"], "mpm, rest"),
        (["stage.object.phases=false"], "mpm"),
        (["stage/object=mpm_paper"], "mpm"),
    ],
)
def test_phases_are_planned(plan, overrides, phases):
    """Every step is taken by the paper's settings, and what does not hold together never flies as one piece."""
    assert {check.name: check.value for check in plan(*overrides).checks}["phases"] == phases


@pytest.mark.parametrize("ablation", ["full", "no_mpm", "no_contact"])
def test_a_video_changes_no_label_and_no_other_step(plan, ablation):
    seen, blind = plan(f"ablation={ablation}"), plan(f"ablation={ablation}", "render=none")
    assert seen.variant == blind.variant
    assert seen.keeps("render") and not blind.keeps("render")
    assert "render" in omitted(blind) and "render" not in omitted(seen)
    assert [step for step in seen.steps if step.name != "render"] == list(blind.steps)
    assert omitted(seen) | {"render"} == omitted(blind)
    assert seen.checks == blind.checks


def test_the_video_is_described(plan):
    (step,) = (s for s in plan("render.view=side", "render.width=96", "render.height=64").steps if s.name == "render")
    assert step.implementation == "taichi"
    assert all(word in step.reason for word in ("40 pictures", "96x64", "side", "run.mp4"))


@pytest.mark.parametrize(
    ("overrides", "spared"),
    [([], False), (["render=none"], True), (["render.backend=reference"], True)],
)
def test_taichi_is_spared_only_where_nothing_needs_it(plan, overrides, spared):
    for ablation in ("no_mpm", "no_contact"):
        (mpm,) = (o for o in plan(f"ablation={ablation}", *overrides).omissions if o.what == "MPM")
        assert ("importing Taichi" in mpm.saves) is spared


def test_nothing_to_simulate_needs_no_mpm(plan):
    made = plan("ablation=no_contact")
    assert "MPM" in omitted(made)
    assert made.checks == ()


def test_paper_settings_are_within_the_limit(plan):
    made = plan("material=paper", "stage/object=mpm_paper")
    checks = {check.name: check for check in made.checks}
    assert 0.5 < float(checks["cfl"].value) < 0.6
    assert float(checks["steps"].value) == 50_000


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["material.poisson_ratio=0.5"], "material.poisson_ratio must lie in (-1, 0.5), got 0.5"),
        (["material.youngs_modulus=-1"], "material.youngs_modulus"),
        (["material.density=0"], "material.density"),
        (["stage.object.dt=0.01"], "dt must be at most"),
    ],
)
def test_refused_before_the_run(plan, overrides, message):
    with pytest.raises(InputError) as caught:
        plan(*overrides)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_printed_plan(plan):
    text = format_plan(plan("ablation=no_mpm"))
    lines = text.splitlines()
    assert lines[0] == "variant no_mpm"
    assert [line.split()[:3] for line in lines[1:7]] == [
        ["RUN", "free_motion", "constant_velocity"],
        ["RUN", "motion", "hmsd"],
        ["RUN", "approach", "step"],
        ["RUN", "coordinate", "adam"],
        ["RUN", "contact", "impulse"],
        ["RUN", "resimulate", "constant_velocity"],
    ]
    assert any(line.split()[:2] == ["OMIT", "MPM"] for line in lines)


def test_planning_is_light():
    """plan_only decides without torch or taichi."""
    code = (
        "import sys; sys.argv = ['hoi.run', 'plan_only=true', 'hydra.run.dir=.']\n"
        "from hoi.run import main\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        "print([m for m in ('torch', 'taichi', 'av', 'mcap', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr


@pytest.mark.parametrize("scene", sorted(path.stem for path in (CONF / "scene").glob("*.yaml")))
@pytest.mark.parametrize("ablation", ["full", "no_mdm", "no_mpm", "no_contact"])
def test_every_scene_can_be_ablated(plan, scene, ablation):
    made = plan(f"scene={scene}", f"ablation={ablation}")
    assert ablation in made.variant.split("+")
