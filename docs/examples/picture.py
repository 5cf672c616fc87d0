"""The renderer alone: a still life of the package's objects, all of them Gaussians."""

import numpy as np
from PIL import Image

import hoi
from hoi.gaussians import transform
from hoi.objects.shapes import SHAPES, build

things = {"cardboard_box": 0.4, "soccer_ball": 0.22, "basketball": 0.24, "foam_cube": 0.5}
places = [0, 0, 0.2], [0, 0, 0.51], [0.12, 0.36, 0.12], [-0.6, 0, 0.25]  # [m]
clouds = [build(SHAPES[name], size).cloud for name, size in things.items()]
clouds = [transform(cloud, np.eye(3), 1, place) for cloud, place in zip(clouds, places, strict=True)]
Image.fromarray(np.uint8(255 * hoi.render(clouds, background=0.95))).save("picture.png")
