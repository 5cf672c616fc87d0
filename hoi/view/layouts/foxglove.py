"""A layout of Foxglove for the topics of a record: 3D scene, video, phases, energies, speed, contact.

The JSON is what Foxglove itself exports: `configById` has the settings of every panel, named KIND!ID, and `layout` the
tree of splits that they stand in.
"""

import json
from pathlib import Path
from typing import Any

from hoi.files import whole_file

SCENE, PICTURE, PHASES = "3D!hoiscene", "Image!hoivideo", "StateTransitions!hoiphase"
ENERGY, SPEED, CONTACT = "Plot!hoienergy", "Plot!hoispeed", "RawMessages!hoicontact"

COLOURS = {"kinetic": "#2b6cb0", "elastic": "#c2571a", "potential": "#5f9e6e", "total": "#22262b"}
"""Of the energies."""


def layout() -> dict[str, Any]:
    """The layout."""
    return {
        "configById": {
            SCENE: _scene(),
            PICTURE: _picture(),
            PHASES: _timed([_series("/object/energy.phase", "object"), _series("/contact.part", "contact")]),
            ENERGY: _plot(
                "energy of the object [J]",
                [_series(f"/object/energy.{name}", name, color=colour) for name, colour in COLOURS.items()],
            ),
            SPEED: _plot(
                "speed [m/s]",
                [
                    _series("/object/energy.speed", "object", color=COLOURS["elastic"]),
                    _series("/contact.v_in", "limb at contact", color="#d61f3c", showLine=False),
                ],
            ),
            CONTACT: {"topicPath": "/contact", "diffEnabled": False, "expansion": "all"},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 0.5},
        "layout": _split(
            "row", _split("column", SCENE, PHASES, 80),
            _split("column", PICTURE, _split("column", ENERGY, _split("row", SPEED, CONTACT, 60), 50), 45), 60,
        ),
    }  # fmt: skip


def write(path: Path) -> None:
    """Write the layout.

    Raises:
        InputError: the path cannot be written to.
        RunError: the disk is full or broken.
    """
    with whole_file(path) as part:
        part.write_text(json.dumps(layout(), indent=2) + "\n", encoding="utf-8")


def _scene() -> dict[str, Any]:
    cloud = {"visible": True, "colorMode": "rgba-fields", "colorField": "x", "pointSizeMode": "fixed", "pointSize": 3}
    return {
        "title": "Scene",
        "followMode": "follow-none",
        "followTf": "world",
        "cameraState": {
            "perspective": True,
            "distance": 4.5,
            "phi": 70,
            "thetaOffset": 60,
            "target": [0, 0, 0],
            "targetOffset": [0, 0.8, 0.9],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.05,
            "far": 200,
        },
        "scene": {"backgroundColor": "#eef0f2", "transforms": {"showLabel": False, "axisScale": 0.1}},
        "transforms": {},
        "topics": {
            "/human/points": cloud,
            "/object/points": cloud,
            "/scene": {"visible": True},
            "/object/com": {"visible": True, "type": "axis", "axisScale": 0.15},
            "/human/joints": {"visible": False},
            "/camera/calibration": {"visible": True, "distance": 0.5},
        },
        "layers": {},
    }


def _picture() -> dict[str, Any]:
    return {
        "title": "Video",
        "imageMode": {"imageTopic": "/camera/video", "calibrationTopic": "/camera/calibration"},
        "followMode": "follow-pose",
        "topics": {"/scene": {"visible": False}, "/human/points": {"visible": False}},
        "transforms": {},
        "layers": {},
    }


def _series(path: str, label: str, **more: Any) -> dict[str, Any]:
    return {"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime", **more}


def _timed(paths: list[dict[str, Any]]) -> dict[str, Any]:
    return {"paths": paths, "isSynced": True}


def _plot(title: str, paths: list[dict[str, Any]]) -> dict[str, Any]:
    shown = {"showLegend": True, "legendDisplay": "floating", "showXAxisLabels": True, "showYAxisLabels": True}
    return {"title": title, "xAxisVal": "timestamp", **shown, **_timed(paths)}


def _split(direction: str, first: Any, second: Any, percentage: float) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}
