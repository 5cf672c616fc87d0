"""Foxglove's layout and Rerun's blueprint name what a record has: topics, fields, frames, entities."""

import json
import os
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest
from demo_run import make_run
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from hoi import record
from hoi.render.cameras import look_at
from hoi.render.encode import encode
from hoi.view.layouts import foxglove
from hoi.view.layouts.__main__ import main

FRAMES = 5


@pytest.fixture(scope="module")
def run():
    return make_run(frames=FRAMES)


@pytest.fixture(scope="module")
def path(run, tmp_path_factory):
    """A record with all topics."""
    path = tmp_path_factory.mktemp("record") / "run.mcap"
    pictures = [np.full((32, 48, 3), 50 * shade, np.uint8) for shade in range(FRAMES)]
    cameras = (look_at((5, -3, 2), (0, 1, 0.8), width=48, height=32),) * FRAMES
    record.write(*run[:1], path, *run[1:], plan_text="", footage=record.Footage(encode(pictures, 20).units, cameras))
    return path


# --- Foxglove ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def topics(path):
    """Topic -> (schema, its first message decoded)."""
    found = {}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            if channel.topic not in found:
                decoded = json.loads(message.data) if channel.message_encoding == "json" else None
                found[channel.topic] = schema, decoded
    return found


def panels(kind):
    return [config for name, config in foxglove.layout()["configById"].items() if name.startswith(f"{kind}!")]


def test_every_panel_has_its_place():
    layout = foxglove.layout()

    def leaves(node):
        return [node] if isinstance(node, str) else [leaf for end in ("first", "second") for leaf in leaves(node[end])]

    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}


def test_the_scene_shows_topics_that_foxglove_draws(topics):
    (scene,) = panels("3D")
    (picture,) = panels("Image")
    for panel in (scene, picture):
        for topic in panel["topics"]:
            assert topics[topic][0].name.startswith("foxglove."), topic
    drawn = {topic for topic, settings in scene["topics"].items() if settings["visible"]}
    assert {"/human/points", "/object/points", "/scene"} <= drawn
    assert topics[picture["imageMode"]["imageTopic"]][0].name == "foxglove.CompressedVideo"
    assert topics[picture["imageMode"]["calibrationTopic"]][0].name == "foxglove.CameraCalibration"


def test_the_frame_of_the_scene_is_there(path):
    (scene,) = panels("3D")
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        (_, _, _, message), *_ = reader.iter_decoded_messages(topics=["/tf"])
    assert scene["followTf"] in {transform.parent_frame_id for transform in message.transforms}


def test_plots_and_phases_name_fields_of_their_kind(topics):
    named = [(series["value"], float | int) for panel in panels("Plot") for series in panel["paths"]]
    named += [(series["value"], str) for panel in panels("StateTransitions") for series in panel["paths"]]
    assert {"/object/energy.kinetic", "/object/energy.phase", "/contact.v_in"} <= {name for name, _ in named}
    for name, kind in named:
        topic, _, field = name.partition(".")
        schema, message = topics[topic]
        assert field in json.loads(schema.data)["properties"], name
        assert isinstance(message[field], kind), name
    (raw,) = panels("RawMessages")
    assert raw["topicPath"] in topics


def test_the_layout_is_written(tmp_path, capsys):
    assert main(["foxglove", "-o", str(tmp_path / "layout.json")]) == 0
    assert json.loads((tmp_path / "layout.json").read_text()) == foxglove.layout()
    assert main(["foxglove", "-o", str(tmp_path / "no" / "layout.json")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "cannot write" in line


# --- Rerun ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stored(path, tmp_path_factory):
    """What the .rrd holds: entity -> component -> rows, and the blueprint's (origin, contents) of each view."""
    chunks = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not here, or an older one")
    out = tmp_path_factory.mktemp("rerun") / "run.rrd"
    command = [sys.executable, "-m", "hoi.view.layouts", "rerun", str(path), "-o", str(out)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{out}\n", "")
    assert [file.name for file in out.parent.iterdir()] == ["run.rrd"]
    reader = chunks.RrdReader(out)
    (blueprint,) = reader.blueprints()
    entities = defaultdict(lambda: defaultdict(list))
    for chunk in reader.stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            entities[chunk.entity_path][name] += batch.column(name).to_pylist()
    views = defaultdict(dict)
    for chunk in reader.stream(store=blueprint):
        batch = chunk.to_record_batch()
        for name in ("ViewBlueprint:space_origin", "ViewContents:query", "SpatialInformation:target_frame"):
            if name in batch.schema.names and chunk.entity_path.startswith("/view/"):
                views[chunk.entity_path.split("/")[2]][name] = batch.column(name).to_pylist()[-1]
    return entities, list(views.values())


def test_rerun_reads_these_topics_itself(stored):
    entities, _ = stored
    for entity, component in {
        "/human/points": "Points3D:positions",
        "/object/points": "Points3D:colors",
        "/human/joints": "InstancePoses3D:translations",
        "/camera/video": "VideoStream:sample",
        "/camera/calibration": "Pinhole:image_from_camera",
        "/tf": "Transform3D:translation",
    }.items():
        assert len(entities[entity][component]) >= FRAMES, entity
    drawn = {name.partition(":")[0] for name in entities["/scene"]} & {"LineStrips3D", "Boxes3D", "Arrows3D"}
    assert not drawn, "Rerun draws /scene by now: hoi.view.layouts need not"


def test_the_blueprint_names_entities_that_are_there(stored):
    entities, views = stored
    assert len(views) == 5
    for view in views:
        (origin,) = view["ViewBlueprint:space_origin"]
        for query in view["ViewContents:query"]:
            named = query.replace("$origin", origin).removesuffix("/**")
            assert any(entity == named or entity.startswith(f"{named}/") for entity in entities), named
    (frame,) = (view["SpatialInformation:target_frame"] for view in views if "SpatialInformation:target_frame" in view)
    parents = {parent for row in entities["/tf"]["Transform3D:parent_frame"] if row for parent in row}
    assert frame == ["world"] and "world" in parents


def test_what_rerun_leaves_out_is_on_its_clock(stored, run, path):
    entities, _ = stored
    trajectory, contact = run[0].state.trajectory, run[0].state.contact.contacts[0]

    def values(entity, component):
        rows = entities[entity]
        chosen = [value for value in rows[component] if value is not None]
        return [time.timestamp() for time in rows["message_log_time"]], chosen

    times, kinetic = values("/object/energies/kinetic", "Scalars:scalars")
    np.testing.assert_allclose(times, np.arange(FRAMES) / 20, atol=1e-6)
    np.testing.assert_allclose(np.ravel(kinetic), trajectory.energy[:, 0])
    _, total = values("/object/energies/total", "Scalars:scalars")
    np.testing.assert_allclose(np.ravel(total), trajectory.energy.sum(1))
    times, strips = values("/human/bones", "LineStrips3D:strips")
    assert len(strips) == FRAMES and {len(frame) for frame in strips} == {23}
    ends = np.array(strips[2])
    joints = record.joints(path)[2]
    assert np.abs(ends.reshape(-1, 1, 3) - joints).max(2).min(1).max() < 1e-5
    times, origins = values("/contact/normal", "Arrows3D:origins")
    np.testing.assert_allclose(times, [contact.frame / 20], atol=1e-6)
    np.testing.assert_allclose(origins[0], [contact.point], atol=1e-6)
    times, phases = values("/object/phase", "StateChange:state")
    assert [phase for (phase,) in phases] == ["rest", "mpm"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere there is always a display")
def test_without_a_display_the_viewer_is_one_line(path):
    pytest.importorskip("rerun.chunk", reason="rerun-sdk is not here, or an older one")
    environment = {key: value for key, value in os.environ.items() if "DISPLAY" not in key and key != "WAYLAND_SOCKET"}
    command = [sys.executable, "-m", "hoi.view.layouts", "rerun", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60)
    assert done.returncode == 2 and not done.stdout
    (line,) = done.stderr.splitlines()
    assert line.startswith("layouts: Rerun opens no window; -o FILE.rrd")


@pytest.mark.parametrize("name", ["foreign.mcap", "missing.mcap"])
def test_a_foreign_file_is_refused(name, tmp_path, capsys):
    (tmp_path / "foreign.mcap").write_text("no record")
    assert main(["rerun", str(tmp_path / name), "-o", str(tmp_path / "x.rrd")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert name in line
    assert not (tmp_path / "x.rrd").exists()
