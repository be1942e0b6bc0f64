"""The example programs of one file: what each prints is what an oracle of its own says."""

import math
import re
import runpy
from pathlib import Path

import duckdb
import numpy as np
import pytest

import ssduck

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PROGRAMS = sorted(EXAMPLES.glob("*.py"))
NUMBER = re.compile(r"-?\d+\.\d+")


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs a program in a folder of its own: its names, and the lines that it prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["example"])

    def program(name):
        names = runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        return names, capsys.readouterr().out.splitlines()

    return program


def numbers(line):
    return [float(number) for number in NUMBER.findall(line)]


def test_there_are_six_programs_and_the_manual_lists_them():
    assert len(PROGRAMS) == 6
    page = (EXAMPLES.parent / "docs" / "README.md").read_text(encoding="utf-8")
    for path in PROGRAMS:
        assert f"`examples/{path.name}`" in page
        text = path.read_text(encoding="utf-8")
        assert f"`python examples/{path.name}" in text
        assert 30 <= len(text.splitlines()) <= (140 if path.stem == "plain_record" else 75)


def test_stop_when_ends_where_a_loop_over_mujoco_does(run):
    mujoco = pytest.importorskip("mujoco")
    names, (done, place, fastest) = run("stop_when")
    model = mujoco.MjModel.from_xml_string(names["XML"])
    data, now = mujoco.MjData(model), mujoco.MjData(model)
    floor, cube = model.body("floor").id, model.body("cube").id
    since, most = None, (0.0, 0.0)
    while since is None or data.time - since < 0.1 - 1e-9:
        mujoco.mj_step(model, data)
        now.qpos, now.qvel = data.qpos, data.qvel  # poses and contacts of this time
        mujoco.mj_forward(model, now)
        speed = np.linalg.norm(now.qvel[:3])
        most = max(most, (speed, data.time))
        slow = speed <= 0.01 and np.linalg.norm(now.qvel[3:]) <= 0.1
        since = (data.time if since is None else since) if slow else None
    bodies = {tuple(sorted(model.geom_bodyid[c.geom])) for c in now.contact}
    assert bodies == {(floor, cube)}  # at rest on the floor, not on the ramp
    assert numbers(done) == pytest.approx([data.time], abs=1e-3)
    assert numbers(place) == pytest.approx([now.qpos[0]], abs=1e-3)
    assert numbers(fastest) == pytest.approx(most, abs=1e-3)


def test_score_policy_counts_as_a_loop_over_observations_does(run):
    pytest.importorskip("mujoco")
    gymnasium = pytest.importorskip("gymnasium")
    names, lines = run("score_policy")
    env = gymnasium.make("InvertedPendulum-v5")
    for line, policy in zip(lines, (names["idle"], names["balance"]), strict=True):
        totals, successes = [], 0
        for seed in range(10):
            (x, angle, *rest), _ = env.reset(seed=seed)
            total, held, over = 0.0, 0.0 if near_middle(x, angle) else None, False
            while not over:
                action = np.clip(policy(np.array([x, angle, *rest])), -3, 3)
                (x, angle, *rest), _, terminated, truncated, _ = env.step(np.float32([action]))
                held = (
                    (0.0 if held is None else held + env.unwrapped.dt)
                    if (near_middle(x, angle))
                    else None
                )
                success = held is not None and held >= 1.0 - 1e-9
                total += math.cos(angle) - abs(x) + 10 * success
                over = success or math.cos(angle) < 0.9 or terminated or truncated
            totals.append(total)
            successes += success
        assert f"{policy.__name__} " in line
        assert f" {successes} of 10 succeed" in line
        assert numbers(line) == pytest.approx([np.mean(totals)], abs=0.01)
    assert successes == 10


def near_middle(x, angle):
    return math.cos(angle) > 0.99 and abs(x) < 0.1


def test_first_touch_is_that_of_the_table_of_contacts(run, tmp_path):
    _, (first, hardest, touches) = run("first_touch")
    with ssduck.open(tmp_path / "dropped") as ss:
        rows = ss.sql("""
            WITH pair AS (SELECT list_sort(list(id)) AS ids FROM entities_model
                          WHERE name IN ('can', 'table'))
            SELECT t.time, coalesce(sum(c.force), 0) FROM ticks_history t CROSS JOIN pair
            LEFT JOIN contacts_history c ON c.tick = t.tick AND [c.a, c.b] = ids
            GROUP BY ALL ORDER BY t.time
        """).fetchall()
    pressed = [force > 0 for _, force in rows]
    begins = [n for n, now in enumerate(pressed) if now and not (n and pressed[n - 1])]
    assert numbers(first) == pytest.approx([rows[begins[0]][0]], abs=1e-4)
    force, time = max((force, time) for time, force in rows)
    assert numbers(hardest) == pytest.approx([time, force], abs=0.01)
    assert touches.startswith(f"{len(begins)} touches")
    lasting = sum(pressed[:-1]) / 240  # each tick counts until the next one
    assert numbers(touches) == pytest.approx([lasting], abs=1e-3)


def test_first_touch_takes_any_record_and_names(run, monkeypatch, tmp_path):
    times = np.arange(10) / 10
    things = {"a box": {"box": [1, 1, 1]}, "b": {"sphere": 0.1}}
    poses = {"a box": [0, 0, 0], "b": np.column_stack((0 * times, 0 * times, 2 + times))}
    ssduck.write_record(tmp_path / "apart", things, poses, times, world="field")
    monkeypatch.setattr("sys.argv", ["example", "apart", "a box", "bb"])
    with pytest.raises(ssduck.SelectScriptError, match="bb"):
        runpy.run_path(str(EXAMPLES / "first_touch.py"), run_name="__main__")


def test_find_failures_lists_what_the_files_say(run):
    _, (count, *lines) = run("find_failures")
    rows = duckdb.sql("""
        SELECT episode, arg_max(x, tick), arg_max(z, tick), min(time) FILTER (WHERE z < 0.41)
        FROM read_parquet('pushes/runs/entities/**/*.parquet', hive_partitioning = true)
        WHERE name = 'puck' GROUP BY episode
    """).fetchall()
    expected = {episode: "fell" for episode, _, z, _ in rows if z < 0.3}
    expected |= {episode: "short" for episode, x, z, _ in rows if z > 0.3 and x < 0.2}
    assert count == f"{len(expected)} of 50 failed"
    assert {int(line.split()[1]): line.split()[0] for line in lines} == expected
    assert set(expected.values()) == {"fell", "short"}
    ends = {episode: (x, below) for episode, x, _, below in rows}
    speeds = {e.number: e.tags["speed"] for e in ssduck.episodes("pushes/runs")}
    for line in lines:
        episode, (speed, x, *off) = int(line.split()[1]), numbers(line)
        assert speed == pytest.approx(speeds[episode], abs=1e-3)
        assert x == pytest.approx(ends[episode][0], abs=1e-3)
        assert bool(off) == (expected[episode] == "fell")
        if off:  # no longer over the table, shortly before it is a centimetre lower
            assert 0 < ends[episode][1] - off[0] < 0.35
        else:  # friction: v^2 / (2 mu g), with mu = 0.5 * 0.5
            assert x + 0.5 == pytest.approx(speed**2 / (2 * 0.25 * 9.81), rel=0.1)
    assert [numbers(line)[0] for line in lines] == sorted(numbers(line)[0] for line in lines)


def test_judge_batch_counts_as_numpy_does(run):
    pytest.importorskip("mujoco")
    names, lines = run("judge_batch")
    goal = np.array(names["GOAL"])
    aims = np.random.default_rng(1).normal(goal[:2], 0.06, (256, 2))
    held = np.full(256, -1.0)
    told = iter(lines)
    for step in range(1, 61):
        places = names["positions"](step * 0.05, aims)
        distance = np.linalg.norm(places - goal, axis=1)
        there = (places[:, 2] == 0.225) & (distance < 0.1)
        held = np.where(there, np.where(held < 0, 0.0, held + 0.05), -1.0)
        success = held >= 0.3 - 1e-9
        if step % 10 == 0:
            counts = f"{step * 0.05:.1f} s: {success.sum()} won, {(places[:, 2] < 0).sum()} lost"
            line = next(told)
            assert line.startswith(f"{counts}, reward")
            assert numbers(line)[-1] == pytest.approx((5 * success - distance).mean(), abs=1e-3)
    assert success.sum() > 128
