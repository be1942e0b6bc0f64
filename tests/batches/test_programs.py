"""Programs over a batch are those over each of its simulations, attached as a world of its own."""

import re
import warnings

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssduck
from ssduck.errors import (
    ArgumentError,
    ProgramWarning,
    SelectScriptError,
    UnsupportedError,
)
from ssduck.interpreter.batches.evaluator import BatchExpressions
from ssduck.interpreter.batches.expressions import MANY
from ssduck.sql.relations.registry import RELATIONS
from tests.batches.conftest import COUNT, MODEL, States, each, simulations
from tests.support.cases import generated, sampled

EXPRESSIONS = [
    "z(sim.cube)",
    "above(sim.cube, sim.table)",
    "exp(-3 * distance(sim.cube, [0.1, 0, 0.5]))",
    "norm(position(sim.cube)) + abs(x(sim.ball)) - sqrt(z(sim.ball))",
    "max([z(sim.cube), 0.4]) + min([z(sim.cube), 0.4]) + clip(z(sim.ball), 0.36, 0.38)",
    "tanh(x(sim.cube)) * cos(y(sim.cube)) / (1 + z(sim.cube)) ^ 2",
    "IF(z(sim.cube) > 0.4; position(sim.cube); linearVelocity(sim.cube))",
    "IF(on(sim.table, sim.cube); 1; 0.5)",
    "rot(sim.cube)[0][1]",
    "atan2(rot(sim.cube)[1][0], rot(sim.cube)[0][0])",
    "distance(sim.cube.top, sim.ball)",
    "speed(sim.cube)",
    "upright(sim.cube, 0.2)",
    "int(z(sim.cube) > 0.4) + 1.5",
    "position(sim.ball)[2]",
    "name(sim.cube)",
    "1 + 1",
    "z(sim.cube) > 0.4 AND touching(sim.cube, sim.table) OR NOT near(sim.cube, sim.ball, 0.1)",
    "touching(sim.arm.hand, sim.cube)",
    "inContact(sim.arm.hand, sim.cube)",
    "clearance(sim.cube, sim.ball)",
    "joint(sim.arm, 'elbow')",
    "isOpen(sim.arm, 'elbow', 0.6) OR isClosed(sim.arm)",
    "mass(sim.cube) * z(sim.cube)",
    "str(z(sim.cube))",
]
# Of each world its own: each attached world counts its ticks, an entity is in every environment.
OWN = ("tick", "obj", "robot", "kinbody", "sensor")
# The arguments with which the relations of one and of two entities are called.
ARGUMENTS = {
    1: ["sim.cube", "sim.arm"],
    2: ["sim.cube, sim.table", "sim.ball, sim.cube", "sim.arm, sim.ball", "sim.cube, sim.cube"],
}
CALLS = {
    name: ARGUMENTS[relation.required_count]
    for name, relation in RELATIONS.items()
    if name not in OWN
    and {p.type for p in relation.parameters if not p.optional} == {"entity"}
    and relation.required_count in ARGUMENTS
}


def outcome(evaluate):
    try:
        return evaluate()
    except SelectScriptError as error:
        return type(error).__name__


def agree(found, expected):
    """Checks that values are equal; functions of numpy may differ in the last bit."""
    if isinstance(found, str) or isinstance(expected, str):
        return found == expected
    found = found.tolist() if isinstance(found, np.ndarray) else [found] * len(expected)
    return all(map(same, found, expected)) and len(found) == len(expected)


def same(found, expected):
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    if isinstance(expected, float | int) and not isinstance(expected, bool):
        return found == pytest.approx(expected, rel=1e-12)
    return found == expected or (expected is None and str(found) in ("None", "nan"))


@sampled("text", EXPRESSIONS, every=2)
def test_expressions(batch, monkeypatch, text):
    ss, sim, model, states = batch
    expected = each(model, states, f"{text};")
    assert agree(ss.eval(f"{text};"), expected)
    sim.tick(states)
    asked = []
    choose = type(sim.ticker).choose
    monkeypatch.setattr(type(sim.ticker), "choose", lambda *a: asked.append(a[1]) or choose(*a))
    assert agree(ss.eval(f"{text};"), expected)
    # Arrays have all values but those that are texts of numbers.
    assert asked == ([*range(COUNT)] if text.startswith("str") else [])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ssduck.errors.ProgramWarning", "ignore:.*contacts")
@sampled("name", CALLS, every=8)
def test_relations(batch, name):
    ss, _, model, states = batch
    for arguments in CALLS[name]:
        text = f"{name}({arguments});"
        expected = outcome(lambda text=text: each(model, states, text))
        assert agree(outcome(lambda text=text: ss.eval(text)), expected), text


NUMBERS = st.sampled_from(
    [
        "z(sim.cube)",
        "x(sim.ball)",
        "distance(sim.cube, sim.ball)",
        "clearance(sim.cube, sim.ball)",
        "speed(sim.ball)",
        "0.37",
        "-1",
        "goal[1]",
        "height",
    ]
)
TRUTHS = st.sampled_from(
    ["on(sim.table, sim.cube)", "inContact(sim.cube, sim.ball)", "isOpen(sim.arm)", "True"]
)
EXPRESSION = st.recursive(
    NUMBERS,
    lambda part: st.one_of(
        st.builds("({} {} {})".format, part, st.sampled_from("+-*/"), part),
        st.builds("{}({})".format, st.sampled_from(["exp", "abs", "sqrt", "log"]), part),
        st.builds("IF({}; {}; {})".format, TRUTHS, part, part),
        st.builds("IF({} < {}; {}; {})".format, part, part, part, part),
    ),
    max_leaves=5,
)


@pytest.mark.slow
@settings(max_examples=generated(8))
@given(st.lists(st.builds("{} > {}".format, EXPRESSION, EXPRESSION) | EXPRESSION, max_size=3))
def test_generated_programs(texts):
    model, states = simulations(4)
    draw = np.random.default_rng(1)
    goal, height = draw.normal(size=(4, 3)), draw.normal(size=4)
    given_values = {"goal": goal.tolist(), "height": height.tolist()}
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.batch(model, 4)).tick(states)
        ss.add_variable("goal", goal)
        ss.add_variable("height", height)
        for text in texts:
            program = f"{text} + 0 * z(sim.cube);" if "sim" not in text else f"{text};"
            expected = outcome(lambda p=program: each(model, states, p, given_values))
            assert agree(outcome(lambda p=program: ss.eval(p)), expected), program
    states.close()


@pytest.mark.filterwarnings("ignore:.*that is no number")
def test_what_is_nan_is_unknown_there_alone(batch):
    ss, sim, model, states = batch
    states[2].xpos[2] = np.nan
    sim.tick(states)
    heights = ss.eval("z(sim.cube);")
    assert np.flatnonzero(np.isnan(heights)).tolist() == [2]
    assert agree(ss.eval("z(sim.ball) > 0.3 OR z(sim.cube) > 0;"), [True] * COUNT)
    with pytest.raises(ArgumentError, match=r"unknown in 1 environments \(2\)"):
        ss.eval("z(sim.cube) > 0.4;")
    expected = each(model, states, "z(sim.ball) * 2;")
    assert agree(ss.eval("z(sim.ball) * 2;"), expected)


def test_an_error_has_the_number_of_its_environment(batch):
    ss, sim, _, states = batch
    states[3].xpos[2] = states[3].xpos[3]
    sim.tick(states)
    with pytest.raises(SelectScriptError, match=r"^environment 3: .*zero|^environment 3: .*0"):
        ss.eval("1 / distance(sim.cube, sim.ball);")
    # Of a branch that is not taken, it is none.
    text = "IF(distance(sim.cube, sim.ball) == 0; 9.0; 1 / distance(sim.cube, sim.ball));"
    assert ss.eval(text)[3] == 9.0


def test_tensors(batch):
    ss, _, model, states = batch
    found = ss.eval("SELECT z(sim.cube), int(z(sim.cube) > 0.4) FROM [0] AS tensor;")
    heights = np.array(each(model, states, "z(sim.cube);"))
    assert np.array_equal(found, np.stack((heights, heights > 0.4), axis=1))
    numbered = ss.eval("SELECT env, z(sim.cube) FROM [0] AS tensor;")
    assert np.array_equal(numbered, np.stack((np.arange(COUNT), heights), axis=1))
    assert np.array_equal(ss.eval("z(sim.cube) + 1.0 * env;"), heights + np.arange(COUNT))
    rows = ss.eval("SELECT z(sim.cube) AS height FROM [0];")
    assert [row["height"] for row in rows] == heights.tolist()


def test_variables_may_change(batch):
    ss, _, model, states = batch
    heights = np.array(each(model, states, "z(sim.cube);"))
    program = ss.compile("z(sim.cube) > limit;")
    for limit in (0.4, 0.35, 1, heights - 0.1, heights + 0.1, 0.4):
        ss.add_variable("limit", limit)
        assert np.array_equal(ss.eval(program), heights > limit)


def test_a_variable_may_be_an_entity(batch):
    ss, sim, model, states = batch
    for name in ("cube", "ball"):
        ss.add_variable("target", sim[name])
        assert agree(ss.eval("z(target);"), each(model, states, f"z(sim.{name});"))


def test_a_point_may_change_to_an_array_and_back(batch, monkeypatch):
    ss, sim, model, states = batch
    sim.tick({name: np.stack([getattr(d, name) for d in states]) for name in ("xpos", "xquat")})
    program, here = ss.compile("distance(sim.cube, target) < 0.2;"), [0.1, 0.0, 0.4]
    expected = each(model, states, f"distance(sim.cube, {here}) < 0.2;")
    asked, choose = [], type(sim.ticker).choose
    for target in (here, np.array(here), tuple(here), np.array([0.1, 0, 0.4], np.float32), here):
        ss.add_variable("target", target)
        ss.eval(program)
        with monkeypatch.context() as patch:
            patch.setattr(type(sim.ticker), "choose", lambda *a: asked.append(a) or choose(*a))
            assert agree(ss.eval(program), expected)
        for wrong, told in (("a", "a text"), (np.zeros(4), "another length")):
            ss.add_variable("target", wrong)
            with pytest.raises(ArgumentError, match=f"environment 0: distance: b .*{told}"):
                ss.eval(program)
    assert asked == []


def test_a_limit_in_a_function_is_no_cliff(batch, monkeypatch):
    ss, sim, _, states = batch
    heights = ss.eval("z(sim.cube);")
    asked = []
    for low, high in ((0.34, 0.37), (0.35, 0.38)):
        ss.add_variable("low", low)
        ss.add_variable("high", high)
        assert np.array_equal(ss.eval("clip(z(sim.cube), low, high);"), heights.clip(low, high))
        monkeypatch.setattr(type(sim.ticker), "choose", lambda _, number: asked.append(number))
        sim.tick(states)
    assert asked == []


def test_margins_are_those_of_the_model():
    model = mujoco.MjModel.from_xml_string(
        MODEL.replace('size="0.04" mass="0.1"', 'size="0.04" mass="0.1" margin="0.02"')
    )
    states = States(mujoco.MjData(model) for _ in range(4))
    for number, data in enumerate(states):
        data.qpos[7:10] = [0, 0, 0.36 + 0.008 * number]
        mujoco.mj_forward(model, data)
    with ssduck.Interpreter(recording=None) as ss:
        ss.add_variable("sim", ssduck.World.batch(model, 4)).tick(states)
        for text in ("touching(sim.ball, sim.table);", "on(sim.table, sim.ball);"):
            expected = each(model, states, text)
            assert agree(ss.eval(text), expected)
            assert len(set(expected)) == 2
    states.close()


def test_an_environment_is_a_world(batch):
    _, sim, model, states = batch
    with ssduck.Interpreter(recording=None) as one:
        one.add_variable("sim", sim.environment(5))
        for text in ("contactForce(sim.cube, sim.table);", "joint(sim.arm, 'elbow');"):
            assert one.eval(text) == each(model, states, text)[5]
    with pytest.raises(ArgumentError, match=f"from 0 to {COUNT - 1}"):
        sim.environment(COUNT)


TICKS = [
    ({"xpos": np.zeros((7, 6, 3))}, "qpos"),
    (
        {"xpos": np.zeros((7, 6, 3)), "xquat": np.zeros((COUNT, 6, 4))},
        rf"\(7, 6, 3\), not \({COUNT}, 6, 3\).*first axis",
    ),
    ({"xpos": np.zeros((6, 3)), "xquat": np.zeros((COUNT, 6, 4))}, "first axis"),
    ({"xpos": np.zeros((COUNT, 6, 3)), "xquat": np.zeros((COUNT, 6, 4))}, "length 0, not 1"),
    ({"xpos": [["a"]], "xquat": 1}, "array of numbers"),
    ({"qpos": np.zeros((COUNT, 15)), "xposs": 1}, "did you mean.*xpos|xpos"),
    ({"qpos": np.zeros((COUNT, 15)), "contact": {"geom": np.zeros((COUNT, 2, 2), int)}}, "dist"),
    (
        {
            "qpos": np.zeros((COUNT, 15)),
            "contact": {"geom": np.full((COUNT, 2, 2), 9), "dist": np.zeros((COUNT, 2))},
        },
        "9, and the model has 6 geoms",
    ),
]


@pytest.mark.parametrize(("arrays", "message"), TICKS)
def test_wrong_states_are_errors_and_the_last_ones_remain(batch, arrays, message):
    ss, sim, _, _ = batch
    before = ss.eval("z(sim.cube);")
    with pytest.raises(ArgumentError, match=message):
        sim.tick(**arrays)
    assert np.array_equal(ss.eval("z(sim.cube);"), before)


@pytest.mark.parametrize(
    "call",
    [
        lambda ss, sim: sim.step(),
        lambda ss, sim: sim.run(1.0),
        lambda ss, sim: sim.render(),
        lambda ss, sim: ss.sql("SELECT * FROM sim.links"),
        lambda ss, sim: sim["cube"].position,
        lambda ss, sim: ss.eval("obj(sim.cube);"),
        lambda ss, sim: ss.eval("SELECT this FROM sim AS list;"),
        lambda ss, sim: ss.eval("SELECT this FROM sim AS environment;"),
        lambda ss, sim: ss.eval("x = z(sim.cube); x > 1;"),
        lambda ss, sim: ss.eval("holds(z(sim.cube) > 0.3);"),
        lambda ss, sim: ss.eval("heldFor(z(sim{0.0}.cube) > 0.3);"),
        lambda ss, sim: ss.add_trigger("t", "z(sim.cube);", 0.1, print),
        lambda ss, sim: ss.record("sim", ssduck.Recording()),
    ],
)
def test_what_only_one_world_can_says_so(batch, call):
    with pytest.raises(UnsupportedError, match=r"batch|environment|every"):
        call(*batch[:2])


def test_a_tick_stays_as_it_is(batch):
    ss, sim, _, states = batch
    arrays = {name: np.stack([getattr(d, name) for d in states]) for name in ("xpos", "xquat")}
    before = ss.eval("z(sim.cube);")
    sim.tick(arrays)
    arrays["xpos"][:] = 7.0
    answer = ss.eval("z(sim.cube);")
    answer[:] = 8.0
    assert np.array_equal(ss.eval("z(sim.cube);"), before)


@pytest.mark.parametrize("library", ["array_api_strict", "torch", "jax.numpy"])
def test_answers_are_of_the_library_of_the_states(batch, library):
    xp = pytest.importorskip(library)
    ss, sim, _, states = batch
    arrays = {name: np.stack([getattr(d, name) for d in states]) for name in ("xpos", "xquat")}
    before = {text: ss.eval(text) for text in ("z(sim.cube);", "touching(sim.cube, sim.table);")}
    sim.tick(**{name: xp.asarray(array) for name, array in arrays.items()})
    for text, expected in before.items():
        answer = ss.eval(text)
        assert type(answer) is type(xp.asarray(expected))
        assert np.allclose(np.asarray(answer), expected, atol=1e-6)  # jax has single precision


@pytest.mark.parametrize(
    ("text", "array"),
    [
        ("speed(sim.cube) < 1;", "cvel="),
        ("z(sim.cube.top);", "site_xpos="),
        ("joint(sim.arm, 'elbow');", "qpos="),
        ("inContact(sim.cube, sim.table);", "contact="),
    ],
)
def test_arrays_that_are_not_known_are_an_error(batch, text, array):
    ss, sim, _, states = batch
    arrays = {name: np.stack([getattr(d, name) for d in states]) for name in ("xpos", "xquat")}
    sim.tick(arrays)
    with pytest.raises(ArgumentError, match=array):
        ss.eval(text)


def test_contacts_in_arrays(batch):
    ss, sim, model, states = batch
    most = max(data.ncon for data in states)
    geom, dist, force = (
        np.full((COUNT, most, 2), -1),
        np.zeros((COUNT, most)),
        np.zeros((COUNT, most)),
    )
    frame = np.zeros((COUNT, most, 9))
    for number, data in enumerate(states):
        for place in range(data.ncon):
            geom[number, place] = data.contact.geom[place]
            dist[number, place] = data.contact.dist[place]
            frame[number, place] = data.contact.frame[place]
            wrench = np.zeros(6)
            mujoco.mj_contactForce(model, data, place, wrench)
            force[number, place] = wrench[0]
    texts = [
        f"{name}(sim.{a}, sim.{b});"
        for name in ("hasContact", "inContact", "contactForce", "grasped")
        for a, b in (("cube", "table"), ("ball", "cube"), ("ball", "table"))
    ]
    expected = [ss.eval(text) for text in texts]
    arrays = {name: np.stack([getattr(d, name) for d in states]) for name in ("xpos", "xquat")}
    contact = {"geom": geom, "dist": dist, "force": force, "frame": frame}
    sim.tick(**arrays, contact=contact)
    assert all(agree(ss.eval(text), list(e)) for text, e in zip(texts, expected, strict=True))
    assert any(values.any() for values in expected)
    sim.tick(**arrays, contact={"geom": geom, "dist": dist})
    assert agree(ss.eval(texts[0]), list(expected[0]))
    with pytest.raises(ArgumentError, match="no force"):
        ss.eval(texts[3])


def test_a_program_without_the_batch_is_one_value(batch):
    assert batch[0].eval("1 + 1;") == 2


def test_compiled_once(batch, monkeypatch):
    ss, sim, _, states = batch
    ss.eval("z(sim.cube) > 0.3;")
    made = []
    init = BatchExpressions.__init__
    monkeypatch.setattr(BatchExpressions, "__init__", lambda *args: made.append(1) or init(*args))
    for _ in range(3):
        sim.tick(states)
        ss.eval("z(sim.cube) > 0.3;")
    assert made == []


@pytest.mark.parametrize(
    ("text", "calls"),
    [
        ("str(z(sim.cube));", "str, z"),
        ("SELECT env, stddev(z) FROM sim AS list;", "stddev"),
        ("SELECT env, str(z) FROM sim AS list;", "str"),
        ("z(sim.cube) > 0.3;", ""),
        ("SELECT env, max(z) FROM sim AS list;", ""),
    ],
)
@pytest.mark.parametrize("count", [MANY - 1, MANY])
def test_many_environments_that_are_asked_one_by_one_are_told_of(text, calls, count):
    model, states = simulations(2)
    with ssduck.Interpreter() as ss, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sim = ss.add_variable("sim", ssduck.World.batch(model, count))
        for _ in range(2):
            sim.tick([states[number % 2] for number in range(count)])
            ss.eval(text)
    told = [str(w.message) for w in caught if issubclass(w.category, ProgramWarning)]
    expected = f"each of {count} environments is asked by itself, .* what calls .*{calls}"
    assert len(told) == (calls != "" and count == MANY)
    assert all(re.match(expected, text) for text in told)


def test_a_warning_is_that_of_a_world(batch):
    with pytest.warns(ProgramWarning, match="eighth"):
        batch[0].eval("volume(sim.cube);")
