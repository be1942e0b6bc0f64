"""Handles of links: their names, errors, sources and result forms, and users' functions of them."""

from __future__ import annotations

import json
import re

import pybullet
import pybullet_data
import pytest

import ssduck
from ssduck.errors import (
    ArgumentError,
    ParseError,
    RemovedEntityError,
    UnknownNameError,
    UnsupportedError,
)
from ssduck.schema import LINK_FACTOR, MAX_LINKS, link_id
from tests.support.bodies import solid
from tests.support.cases import sampled

HAND = "sim.panda.panda_hand"


def test_a_handle(cell):
    panda = cell.world["panda"]
    hand = panda.link("panda_hand")
    assert hand == cell.ss.eval(f"{HAND};") == panda["panda_hand"] == panda.links[hand.number]
    assert hand != panda.links[0]
    assert len({hand, panda.link("panda_hand"), panda}) == 2
    assert isinstance(hand, ssduck.Link)
    assert (hand.name, hand.full_name, hand.kind) == ("panda_hand", "panda.panda_hand", "link")
    assert repr(hand) == "<link 'panda.panda_hand'>"
    assert hand.entity == panda
    assert hand.id == link_id(panda.id, hand.number) > LINK_FACTOR
    assert hand.parent == panda.link("panda_link8")
    assert panda.links[0].parent is None
    assert [link.number for link in panda.links] == list(range(len(panda.links)))
    assert panda.mass == pytest.approx(sum(link.mass for link in panda.links))


def test_ids_fit():
    assert link_id(LINK_FACTOR - 1, MAX_LINKS - 1) < 2**31


@pytest.mark.parametrize(
    ("program", "near"),
    [
        ("sim.panda.panda_leftfingr;", "panda_leftfinger"),
        ("near(sim.panda.panda_hnd, sim.cube, 1);", "panda_hand"),
        ("sim.pand.panda_hand;", "panda"),
        ("SELECT id FROM sim WHERE near(this, sim.panda['panda_hnd'], 1);", "panda_hand"),
    ],
)
def test_unknown_names_are_errors_with_the_nearest(cell, program, near):
    for ss in cell.interpreters:
        with pytest.raises(UnknownNameError) as caught:
            ss.eval(program)
        assert near in caught.value.suggestions
    with pytest.raises(UnknownNameError, match="panda_hand"):
        cell.world["panda"].link("panda_hnd")


@pytest.mark.parametrize("word", ["select", "where", "FROM"])
def test_words_of_the_language_are_names_in_brackets(cell, word):
    for ss in cell.interpreters:
        with pytest.raises(ParseError, match=re.escape(f"(write ['{word}'] for a word")):
            ss.eval(f"sim.panda.{word};")
        with pytest.raises(ssduck.SelectScriptError, match=f"'{word}'") as caught:
            ss.eval(f"sim.panda['{word}'];")
        assert not isinstance(caught.value, ParseError)
    with pytest.raises(ParseError, match="expected a key, found ';'"):
        cell.ss.eval("sim.panda.;")


@pytest.mark.slow
def test_functions_of_links(cell):
    for ss in cell.interpreters:
        assert ss.eval(f"entity({HAND}) == sim.panda AND entity(sim.cube) == sim.cube;")
        assert ss.eval(f"id(parent({HAND}));") == "panda.panda_link8"
        assert ss.eval("parent(sim.panda.panda_link0);") is None
        assert ss.eval("links(sim.cube);") == cell.world["cube"].links
        names = ss.eval("SELECT id FROM links(sim) AS list;")
        assert names == [link.full_name for entity in cell.world for link in entity.links]
        assert ss.eval("SELECT id FROM links(sim) WHERE entity(this) == sim.panda AS list;") == [
            link.full_name for link in cell.world["panda"].links
        ]
        number = cell.world.snapshot.number
        last = ss.eval(f"SELECT id FROM links(sim{{}}) WHERE tick(this) == {number} AS list;")
        assert last == names
        for program in ("links(5);", "entity('panda');", "parent(sim.cube);"):
            with pytest.raises(ArgumentError):
                ss.eval(program)
        with pytest.raises(UnsupportedError, match="entity"):
            ss.eval(f"joint({HAND}, 'panda_joint1');")


def test_handles_of_the_past_stay_at_their_tick(cell):
    for ss in cell.interpreters:
        first, *_, last = ss.eval(f"SELECT this FROM links(sim{{}}) WHERE this == {HAND} AS list;")
        assert first == last == cell.world["panda"].link("panda_hand")
        assert first.position != last.position
        assert first.entity.position == cell.world["panda"].position
        ss.add_variable("then", first)
        assert ss.eval("position(then);") == first.position
        ss.eval("clear('then');")


@pytest.mark.slow
def test_variables_hold_links(cell):
    for ss in cell.interpreters:
        program = f"hand = {HAND}; SELECT id FROM sim WHERE near(this, hand, 0.1) AS list;"
        found = ss.eval(program)
        assert "cube" in found
        assert "panda" not in found
        some = ss.eval(f"some = [{HAND}, sim.panda.panda_link7]; SELECT mass FROM some AS list;")
        assert some == [cell.world["panda"].link(n).mass for n in ("panda_hand", "panda_link7")]
        mixed = ss.eval(f"SELECT type FROM [{HAND}, sim.cube] AS list;")
        assert mixed == ["link", "kinbody"]


def test_functions_with_type_hints(cell):
    ss = cell.ss

    def height(link: ssduck.Link) -> float:
        assert isinstance(link, ssduck.Link)
        return link.position[2]

    ss.add_function("height_of_link", height, "The height of a link.")
    query = "SELECT id FROM links(sim) WHERE height_of_link(this) > 0.3 AS list;"
    assert "Python" not in ss.explain(query)
    assert ss.eval(query) == ss.eval("SELECT id FROM links(sim) WHERE z > 0.3 AS list;")


@pytest.mark.slow
def test_result_forms_show_names(cell):
    ss = cell.ss
    names = ["panda.panda_hand", "panda.panda_leftfinger"]
    rows = f"SELECT this FROM [{HAND}, sim.panda.panda_leftfinger]"
    assert [row["this"] for row in json.loads(ss.eval(f"{rows} AS json;"))] == names
    assert ss.eval(f"{rows} AS table;").fetchall() == [(name,) for name in names]
    facts = ss.eval(
        "SELECT near(sim.cube, this, 1) FROM [sim.panda.panda_hand] WHERE z > 0 AS prolog;"
    )
    assert facts == ["near(cube,'panda.panda_hand',1)"]
    graph = ss.eval(
        "SELECT a.this, b.this FROM a = links(sim), b = sim "
        "WHERE inContact(a.this, b.this) AND b.this == sim.cube AS graph;"
    )
    assert ("panda.panda_leftfinger", "cube") in graph.edges
    with pytest.warns(UserWarning, match="motors"):
        copy = ss.eval(f"{rows} AS environment;")
    assert [entity.name for entity in copy] == ["panda"]
    copy.close()
    cloud = ss.eval(f"SELECT this FROM {HAND} AS points(0.01);")
    low, high = cell.world["panda"].link("panda_hand").aabb
    assert (cloud.points >= [x - 1e-6 for x in low]).all()
    assert (cloud.points <= [x + 1e-6 for x in high]).all()
    assert len(ss.eval(f"{rows} AS mesh;").geometry) >= 2


@pytest.mark.slow
@sampled("door", ["folder", "file"], every=2)
def test_records(cell, door, tmp_path):
    """A record answers as the live world does."""
    programs = [
        "SELECT tick, contactForce(this, sim.cube) FROM links(sim{}) "
        "WHERE this == sim.panda.panda_rightfinger AND inContact(this, sim.cube);",
        "SELECT id, force FROM links(sim{0.4}) WHERE entity(this) == sim.panda;",
        "holds(near(sim.panda.panda_leftfinger, sim.cube, 0.01));",
        f"[position({HAND}), id({HAND})];",
    ]
    if door == "folder":
        cell.ss.export(tmp_path / "record")
        expected = [cell.ss.eval(program) for program in programs]
        path = tmp_path / "record"
    else:
        path = tmp_path / "record.duckdb"
        with ssduck.Interpreter(path) as ss:
            ss.add_variable("sim", cell.world)
            programs[1] = programs[1].replace("{0.4}", "{}")
            expected = [ss.eval(program) for program in programs]
    with ssduck.open(path) as ss:
        assert [ss.eval(program) for program in programs] == expected
        ((count, rows),) = ss.sql(
            "SELECT count(DISTINCT full_name), count(id) FROM sim.links_history WHERE enabled"
        ).fetchall()
        assert count == sum(len(entity.links) for entity in cell.world)
        assert rows % count == 0


@pytest.mark.slow
def test_what_if(cell):
    far = cell.world.what_if({"cube": [1, 0, 0, 0, 0.5, 0, 1.5]})
    for ss in cell.interpreters:
        ss.add_variable("maybe", far)
        distance = ss.eval("clearance(maybe.panda.panda_hand, maybe.cube);")
        assert distance > 1 > ss.eval(f"clearance({HAND}, sim.cube);")
        near = "SELECT count(*) FROM maybe.links l, maybe.entities e WHERE e.name = 'cube' "
        ((count,),) = ss.sql(near + "AND maybe.near(l, e, 1)").fetchall()
        assert count == len(
            ss.eval("SELECT id FROM links(maybe) WHERE near(this, maybe.cube, 1) AS list;")
        )


def test_links_of_a_removed_body(client):
    body = solid(client, pybullet.GEOM_SPHERE, 1, radius=0.1)
    world = ssduck.World.attach(client, names={body: "ball"})
    (link,) = world["ball"].links
    for row_by_row in (False, True):
        with ssduck.Interpreter(row_by_row=row_by_row) as ss:
            ss.add_variable("sim", world)
            ss.add_variable("base", link)
            if not row_by_row:
                pybullet.removeBody(body, client)
                world.tick()
            for program in ("entity(base);", "z(base);", "parent(base);", "near(base, base, 1);"):
                with pytest.raises(RemovedEntityError, match=r"'ball\.link0' is no longer"):
                    ss.eval(program)
    assert not link.is_there
    with pytest.raises(RemovedEntityError, match=r"'ball\.link0' is no longer in world"):
        assert link.entity


@pytest.mark.slow
def test_methods_of_worlds_and_entities_take_links_or_say_so(client):
    """A sensor and a held body are fixed to a link; all else is about whole entities."""
    pybullet.setAdditionalSearchPath(pybullet_data.getDataPath(), client)
    panda = pybullet.loadURDF("franka_panda/panda.urdf", useFixedBase=True, physicsClientId=client)
    world = ssduck.World.attach(client, names={panda: "panda"})
    hand = world["panda"].link("panda_hand")
    sensor = world.add_sensor("range_finder", hand, max_range=2.0)
    assert (sensor.host, sensor.spec.link) == (world["panda"].id, "panda_hand")
    assert sensor.position == pytest.approx(hand.position)
    ball = solid(client, pybullet.GEOM_SPHERE, 1, hand.position, radius=0.1)
    world.tick(steps=0)
    held = next(entity for entity in world if entity.kind == "kinbody")
    world["panda"].hold(held, hand)
    constraint = pybullet.getConstraintInfo(pybullet.getConstraintUniqueId(0, client), client)
    assert constraint[:3] == (panda, hand.number - 1, ball)
    world["panda"].release(held)
    with pytest.raises(ArgumentError, match="is no link of 'panda'"):
        world["panda"].hold(held, held.links[0])
    for call in (
        lambda: world.what_if({hand: [1, 0, 0, 0, 0, 0, 1]}),
        lambda: world.excerpt([hand]),
        lambda: world.remove(hand),
        lambda: world[hand],
    ):
        with pytest.raises(ArgumentError, match=r"<link 'panda\.panda_hand'> is a link"):
            call()
    with pytest.raises(ArgumentError, match="give its entity"):
        world.add_sensor("range_finder", hand, link="panda_link0", max_range=2.0)
