"""The published motion prior's skeleton: `python -m hoi.importers.rest_joints SMPLH_NEUTRAL.npz -o rest_joints.npy`.

STMC's MDM-SMPL was trained on joint positions of the neutral SMPL-H body of mean shape, whose hands are its index
fingers' first joints. SMPL and SMPL-X files give the same body, with SMPL's own hand joints of the former.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from hoi.data import Array
from hoi.errors import InputError, about
from hoi.files import whole_file
from hoi.importers.unpickle import read_arrays
from hoi.terminal.arguments import refusing

KEYS = ("v_template", "J_regressor")


def rest_joints(path: Path) -> Array:
    """T-pose joints of the mean shape, SMPL's 24 in its order, y up [m], (24, 3), float32.

    Raises:
        InputError: no SMPL, SMPL-H or SMPL-X model file.
    """
    from hoi.importers.smpl import BODY_JOINTS, FAMILIES

    arrays = read_arrays(path, KEYS)
    with about(path):
        if missing := [key for key in KEYS if key not in arrays]:
            raise InputError(f"{', '.join(missing)}: missing; not an SMPL model file")
        template, regressor = arrays["v_template"], arrays["J_regressor"]
        if regressor.ndim != 2 or len(regressor) not in FAMILIES:
            known = ", ".join(f"{count} ({family.name})" for count, family in FAMILIES.items())
            raise InputError(f"J_regressor: shape {regressor.shape}; must have a row for each joint: {known}")
        if template.shape != (regressor.shape[1], 3) or not np.isfinite(template).all():
            raise InputError(f"v_template: shape {template.shape}; must be ({regressor.shape[1]}, 3) finite numbers")
        index_fingers = [hand[0] for hand in FAMILIES[len(regressor)].hands]
        return (regressor[[*range(BODY_JOINTS), *index_fingers]] @ template).astype(np.float32)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hoi.importers.rest_joints",
        description="The T-pose joints that the published motion prior was trained with, from your own SMPL-H file.",
        epilog="example: python -m hoi.importers.rest_joints SMPLH_NEUTRAL.npz -o rest_joints.npy",
    )
    parser.add_argument("smpl", type=Path, help="SMPL-H's neutral model file, .npz or .pkl; or SMPL's, SMPL-X's")
    parser.add_argument("-o", "--out", type=Path, default=Path("rest_joints.npy"), help="default: rest_joints.npy")
    return parser


def convert() -> None:
    """Reads the command line and writes the file.

    Raises:
        InputError: a file cannot be read or written.
    """
    options = parser().parse_args()
    joints = rest_joints(options.smpl)
    with whole_file(options.out) as part, part.open("wb") as file:
        np.save(file, joints)
    print(f"{options.out}: {len(joints)} joints, the pelvis {joints[0, 1] - joints[10, 1]:.3f} m above the toes")


if __name__ == "__main__":
    sys.exit(refusing(convert))
