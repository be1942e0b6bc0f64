"""Episodes of gymnasium environments go to LeRobot with their actions and rewards."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

import ssduck
from ssduck.errors import ArgumentError, RecordError
from ssduck.gym import QueryWrapper
from ssduck.interchange.conversion import write_runs
from ssduck.recording.episode_steps import EpisodeSteps, action_numbers
from ssduck.recording.folder_episodes import runs_in
from tests.support.lake_episodes import SUCCESS, Push

STEPS = 6


@pytest.fixture
def pushed(tmp_path):
    """A record of two episodes, and the actions of each."""
    env = QueryWrapper(
        Push(),
        success=SUCCESS,
        variables={"goal": lambda env: env.goal},
        reward={"near": "-distance(sim.gripper, sim.cup)"},
        record_to=tmp_path / "record",
    )
    actions = []
    for seed in range(2):
        env.reset(seed=seed)
        given = np.random.default_rng(seed).uniform(-4, 4, (STEPS, 2)).astype(np.float32)
        actions.append(given)
        for action in given:
            changed = action.copy()
            env.step(changed)
            changed[:] = 0  # what was taken is kept
    env.close()
    return tmp_path / "record", actions


def dataset(record, tmp_path, fps=None):
    write_runs(runs_in(record), tmp_path / "dataset", "lerobot", fps)
    info = json.loads((tmp_path / "dataset/meta/info.json").read_text())
    return info, pq.read_table(tmp_path / "dataset/data/chunk-000/file-000.parquet")


def test_actions_and_rewards_of_each_step(pushed, tmp_path):
    record, actions = pushed
    info, rows = dataset(record, tmp_path)
    assert (info["total_frames"], info["fps"]) == (2 * STEPS, 60)
    assert info["features"]["action"] == {
        "dtype": "float64",
        "shape": [2],
        "names": ["action_0", "action_1"],
    }
    assert np.array_equal(np.array(rows["action"].to_pylist()), np.concatenate(actions))
    kept = [EpisodeSteps.read(record, "sim", number) for number in range(2)]
    rewards = [reward for steps in kept for reward in steps.rewards]
    assert rows["next.reward"].to_pylist() == rewards
    assert rows["next.done"].to_pylist() == 2 * [*[False] * (STEPS - 1), True]
    names = set(info["features"]) - {"timestamp"}
    assert names <= set(rows.column_names)
    stats = json.loads((tmp_path / "dataset/meta/stats.json").read_text())
    assert stats["action"]["max"] == pytest.approx(np.concatenate(actions).max(axis=0).tolist())


@pytest.mark.slow
def test_the_observation_is_that_before_the_action(pushed, tmp_path):
    record, _ = pushed
    info, rows = dataset(record, tmp_path)
    names = info["features"]["observation.environment_state"]["names"]
    place = names.index("gripper.x")
    frames = [state[place] for state in rows["observation.environment_state"].to_pylist()]
    told = []
    for number in range(2):
        with ssduck.open(record, "sim", number) as ss:
            told += ss.eval("SELECT x FROM sim{} WHERE id = 'gripper' AS list;")[:-1]
    assert frames == told


def test_several_frames_of_a_step(pushed, tmp_path):
    record, actions = pushed
    _, rows = dataset(record, tmp_path, fps=120)
    taken = np.array(rows["action"].to_pylist()).reshape(2, 2 * STEPS, 2)
    assert np.array_equal(taken[:, ::2], taken[:, 1::2])
    assert np.array_equal(taken[:, ::2], np.stack(actions))
    steps = EpisodeSteps.read(record, "sim", 0)
    rewards = np.array(rows["next.reward"].to_pylist())[: 2 * STEPS]
    assert rewards[1::2].tolist() == steps.rewards
    assert not rewards[::2].any()


def test_steps_without_a_frame_are_an_error(pushed, tmp_path):
    record, _ = pushed
    with pytest.raises(ArgumentError, match=r"6 steps with actions, and no frame in 3 of them"):
        dataset(record, tmp_path, fps=30)
    assert not (tmp_path / "dataset/data").exists()


def change_steps(record, number, change):
    file = record / f"gym/sim-{number}.json"
    content = json.loads(file.read_text())
    content.pop("crc32")
    change(content)
    file.write_text(json.dumps(content))


def test_records_of_an_older_ssduck_have_no_actions(pushed, tmp_path):
    record, _ = pushed
    for number in range(2):
        change_steps(record, number, lambda content: content.pop("actions"))
    info, rows = dataset(record, tmp_path)
    assert not {"action", "next.reward", "next.done"} & (
        set(info["features"]) | {*rows.schema.names}
    )
    assert info["total_frames"] == 2 * (STEPS + 1)


@pytest.mark.parametrize("actions", [[[1.0]], 3, [[1.0], [1.0, 2.0]], [["a"]] * STEPS])
def test_damaged_actions_are_an_error(pushed, tmp_path, actions):
    record, _ = pushed
    change_steps(record, 1, lambda content: content.update(actions=actions))
    with pytest.raises(RecordError, match=r"sim-1\.json"):
        dataset(record, tmp_path)


def test_only_numbers_are_kept():
    assert action_numbers(3) == [3.0]
    assert action_numbers(np.array([[1, 2], [3, 4]], dtype=np.int8)) == [1.0, 2.0, 3.0, 4.0]
    for other in ("left", {"arm": [1.0]}, [[1.0], [1.0, 2.0]], [np.nan], None):
        assert action_numbers(other) is None
    steps = EpisodeSteps({})
    steps.add_action([1.0])
    steps.add_action([1.0, 2.0])
    steps.add_action([1.0])
    assert steps.actions is None
