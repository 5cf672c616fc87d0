"""A tiny checkpoint in the exact layout of HUGS's humans."""

import warnings
from collections import OrderedDict

import numpy as np
import torch
from torch import nn

from hoi.body.kinematics import rotation_from_6d

FEATURES, RESOLUTION, COUNT = 4, 8, 60


class Tiny:
    """HUGS's triplane and decoders, small, with random weights."""

    def __init__(self, blendshapes: bool = False, scales: int = 3, one_joint: bool = False):
        torch.manual_seed(0)
        width = 3 * FEATURES
        self.points = torch.rand(COUNT, 3) * 1.6 - 0.8
        self.multiplier = torch.rand(COUNT, 1) + 0.5
        self.planes = {plane: torch.randn(1, FEATURES, RESOLUTION, RESOLUTION) for plane in ("xy", "xz", "yz")}

        def net(hidden: int) -> nn.Sequential:
            return nn.Sequential(nn.Linear(width, hidden), nn.GELU(), nn.Linear(hidden, hidden), nn.GELU())

        self.appearance = nn.ModuleDict(
            {"net": net(64), "opacity": nn.Sequential(nn.Linear(64, 1), nn.Sigmoid()), "shs": nn.Linear(64, 48)}
        )
        shared = net(128)
        heads = {"xyz": 3, "rotations": 6, "scales": scales}
        self.geometry = nn.ModuleDict({"net": shared})
        self.geometry.update({name: nn.Sequential(shared, nn.Linear(128, out)) for name, out in heads.items()})
        self.deformation = nn.ModuleDict({"net": net(128), "skinning": nn.Linear(128, 24)})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the old weight_norm, whose keys the checkpoint has
            self.deformation["skinning_linear"] = nn.utils.weight_norm(nn.Linear(128, 128))
        if blendshapes:
            self.deformation["blendshapes"] = nn.Linear(128, 621)
            nn.init.normal_(self.deformation["blendshapes"].weight, std=1e-2)
        nn.init.normal_(self.geometry["scales"][1].bias, 0.02, 0.01)
        if one_joint:
            nn.init.constant_(self.deformation["skinning"].bias, -3.0)
            self.deformation["skinning"].bias.data[4] = 30.0
        else:
            nn.init.normal_(self.deformation["skinning"].weight, std=0.3)

    def checkpoint(self) -> dict:
        planes = {f"plane_{name}": nn.Parameter(plane) for name, plane in self.planes.items()}
        xyz = nn.Parameter(self.points)
        optimizer = torch.optim.Adam([{"params": [xyz], "name": "xyz"}], lr=0.0, eps=1e-15)
        return {
            "active_sh_degree": 0,
            "xyz": xyz,
            "triplane": OrderedDict(planes),
            "appearance_dec": self.appearance.state_dict(),
            "geometry_dec": self.geometry.state_dict(),
            "deformation_dec": self.deformation.state_dict(),
            "scaling_multiplier": self.multiplier,
            "max_radii2D": torch.zeros(COUNT),
            "xyz_gradient_accum": torch.zeros(COUNT, 1),
            "denom": torch.zeros(COUNT, 1),
            "optimizer": optimizer.state_dict(),
            "spatial_lr_scale": np.float64(1.3),
        }

    @torch.no_grad()
    def canonical(self) -> dict[str, torch.Tensor]:
        """Bilinear by hand, then the modules themselves."""
        places = (self.points / 2 + 0.5).numpy() * (RESOLUTION - 1)
        features = []
        for name, (across, down) in (("xy", (0, 1)), ("xz", (0, 2)), ("yz", (1, 2))):
            plane = self.planes[name][0].numpy()
            u, v = places[:, across], places[:, down]
            i, j = u.astype(int), v.astype(int)
            a, b = u - i, v - j
            value = (1 - a) * (1 - b) * plane[:, j, i] + a * (1 - b) * plane[:, j, i + 1]
            features.append((value + (1 - a) * b * plane[:, j + 1, i] + a * b * plane[:, j + 1, i + 1]).T)
        x = torch.from_numpy(np.concatenate(features, axis=1)).float()
        hidden = self.deformation["net"](x)
        skinning = nn.functional.gelu(self.deformation["skinning_linear"](hidden))
        canonical = {
            "means": self.points + self.geometry["xyz"](x),
            "rotations": rotation_from_6d(self.geometry["rotations"](x)),
            "scales": nn.functional.gelu(self.geometry["scales"](x)) * self.multiplier,
            "opacity": self.appearance["opacity"](self.appearance["net"](x))[:, 0],
            "shs": self.appearance["shs"](self.appearance["net"](x)).reshape(-1, 16, 3),
            "weights": torch.softmax(nn.functional.gelu(self.deformation["skinning"](skinning)) / 0.1, -1),
        }
        if "blendshapes" in self.deformation:
            canonical["posedirs"] = self.deformation["blendshapes"](hidden).reshape(207, -1)
        return canonical
