"""Lakes of any folders: what is beside the parts is not read, and groups give no other answers."""

import json
import shutil
from dataclasses import replace

import mujoco
import pytest

import ssduck
from ssduck.lakes.engines import answer_locally
from ssduck.lakes.questions import ProgramQuestion
from ssduck.lakes.workers import answer_episodes, forget_readers
from ssduck.recording.stores.files import json_text
from tests.lakes.conftest import EPISODES
from tests.support.cases import sampled
from tests.support.lake_questions import whole_answer_of

PROGRAM = "count(SELECT id FROM sim AS list);"
ENTITIES = "entities/world=sim/episode=1"


ROWS = "count(SELECT id FROM sim{} AS list);"


@pytest.mark.slow
def test_a_file_beside_the_parts_is_not_read(folder):
    wanted = ssduck.lake(folder).ask(ROWS, processes=1)
    part = folder / ENTITIES / "part-000000.parquet"
    (part.parent / "more.parquet").write_bytes(part.read_bytes())
    for _ in range(2):  # without an entry in the manifest, and with one
        assert ssduck.lake(folder).ask(ROWS, processes=1) == wanted


@pytest.mark.parametrize("name", ["row", "ROW", "ssduck row", "Episode", 'a" FROM b; --'])
def test_a_tag_of_any_name_selects_no_other_episodes(folder, name):
    ssduck.lake(folder).set_tags({name: 0}, "episode = 2")
    lake = ssduck.lake(folder)
    assert lake.select("episode = 2")["episode"].to_pylist() == [2]
    assert len(lake.select("ticks > 0")) == EPISODES


MODEL = """
<mujoco>
  <worldbody>
    <body name="table" pos="0 0 .2"><geom type="box" size=".6 .6 .2"/></body>
    <body name="{cup}" pos="0 0 .5"><freejoint/><geom type="sphere" size="{size}"/></body>
    {more}
  </worldbody>
</mujoco>
"""
BALL = '<body name="ball" pos="0 .3 .6"><freejoint/><geom type="sphere" size=".02"/></body>'
# Other words of the model, the name of the world, the number of its steps and its recording.
OTHERS = {
    "the same": {},
    "another shape": {"size": 0.03},
    "another name": {"cup": "mug"},
    "more entities": {"more": BALL},
    "another world": {"name": "lab"},
    "other tables": {"tables": ("links",)},
    "other ticks": {"every": 3},
    "recorded entities": {"entities": ("cup",)},
}
QUESTIONS = (
    "least(clearance(sim.table, sim.cup));",
    "holds(near(sim.table, sim.cup, 0.04));",
    "holds(z(sim.cup) > 0.48);",
    "count(SELECT id FROM sim AS list);",
    "SELECT tick(this) FROM contacts(sim{}) AS list;",
)


def record(folder, *, cup="cup", size=0.05, more="", name="sim", **recording):
    model = mujoco.MjModel.from_xml_string(MODEL.format(cup=cup, size=size, more=more))
    data = mujoco.MjData(model)
    with ssduck.Interpreter(recording=None) as ss:
        world = ss.add_variable(name, ssduck.World.attach(model, data))
        with ss.record_to(folder, recording=ssduck.Recording(**recording)):
            for _ in range(20):
                mujoco.mj_step(model, data, 5)
                world.step()


def by_themselves(entry):
    """The answers of an episode that is opened by itself."""
    with ssduck.open(entry.path, entry.world, entry.episode) as ss:
        return [whole_answer_of(ss, program) for program in QUESTIONS]


@pytest.mark.slow
@sampled("other", OTHERS, every=4)
def test_episodes_are_asked_together_or_apart_with_the_same_answers(tmp_path, other):
    record(tmp_path / "a")
    record(tmp_path / "b", **OTHERS[other])
    entries = ssduck.lake(tmp_path).entries
    assert len({entry.group for entry in entries}) == (1 if other == "the same" else 2)
    expected = [by_themselves(entry) for entry in entries]
    for step in (1, -1):  # either is the first of the group
        forget_readers()
        for program, answers in zip(QUESTIONS, zip(*expected[::step], strict=True), strict=True):
            asked = answer_locally(ProgramQuestion(program), [entries[::step]], 1)
            assert list(asked) == [(0, list(answers))], program


class CameraQuestion(ProgramQuestion):
    """Asks where the camera is that a picture would be taken with."""

    def answering(self, interpreter):
        return lambda present, _: list(present.worlds[0].camera.eye)


@pytest.mark.slow
def test_a_batch_has_the_recorded_camera_of_each_episode(folder, monkeypatch):
    eyes = {number: [1.0 + number % 2, 2.0, 3.0] for number in range(EPISODES)}
    for number, eye in eyes.items():
        file = folder / f"episodes/sim-{number}.json"
        camera = {"eye": eye, "target": [0.0, 0.0, 0.0], "fov": 40.0}
        file.write_text(json_text(json.loads(file.read_text()) | {"camera": camera}))
    shutil.rmtree(folder / "index")  # the summaries say that all have the default camera
    entries = ssduck.lake(folder).entries
    assert len({entry.group for entry in entries}) == 2
    monkeypatch.setattr("ssduck.lakes.workers.answer_by_itself", None)  # all are in a batch
    answers = answer_episodes(CameraQuestion(PROGRAM), entries)
    assert [json.loads(answer.text) for answer in answers] == list(eyes.values())


@pytest.mark.slow
def test_a_manifest_that_groups_other_cameras_changes_none(folder):
    file = folder / "episodes/sim-1.json"
    camera = {"eye": [5.0, 5.0, 5.0], "target": [0.0, 0.0, 0.0], "fov": 40.0}
    file.write_text(json_text(json.loads(file.read_text()) | {"camera": camera}))
    entries = ssduck.lake(folder).entries
    wrong = [replace(entry, group=entries[0].group) for entry in entries]
    answers = answer_episodes(CameraQuestion(PROGRAM), wrong)
    assert [json.loads(one.text) == [5.0, 5.0, 5.0] for one in answers] == [
        number == 1 for number in range(EPISODES)
    ]
