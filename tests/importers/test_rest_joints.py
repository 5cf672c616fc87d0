"""The skeleton that the published motion prior was trained with, from files in SMPL's layouts."""

import subprocess
import sys

import numpy as np
import pytest

from hoi.importers.rest_joints import rest_joints
from hoi.motion.prior import load_prior
from tests.smpl_files import make_model
from tests.stmc_files import write_stmc


@pytest.mark.parametrize(("joints", "hands"), [(24, (22, 23)), (52, (22, 37)), (55, (25, 40))])
def test_joints_are_the_regressors_with_the_index_fingers(tmp_path, joints, hands):
    model = make_model(joints)
    np.savez(tmp_path / "model.npz", **model)
    all_joints = model["J_regressor"] @ model["v_template"]
    np.testing.assert_allclose(rest_joints(tmp_path / "model.npz"), all_joints[[*range(22), *hands]], atol=1e-6)


def test_the_command_writes_what_the_prior_reads(tmp_path, recwarn):
    np.savez(tmp_path / "SMPLH_NEUTRAL.npz", **make_model(52))
    write_stmc(tmp_path / "mdm")
    out = tmp_path / "mdm" / "rest_joints.npy"
    command = [sys.executable, "-m", "hoi.importers.rest_joints", str(tmp_path / "SMPLH_NEUTRAL.npz"), "-o", str(out)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and "24 joints" in done.stdout, done.stderr
    prior = load_prior(tmp_path / "mdm", text_cache=tmp_path)
    np.testing.assert_array_equal(prior.rest_joints.numpy(), rest_joints(tmp_path / "SMPLH_NEUTRAL.npz"))
    (tmp_path / "bad.npz").write_bytes(b"no")
    done = subprocess.run([*command[:3], str(tmp_path / "bad.npz"), "-o", str(out)], capture_output=True, text=True)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
