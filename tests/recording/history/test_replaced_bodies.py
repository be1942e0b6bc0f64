"""A body that takes the name and number of a removed one is another entity to functions of time."""

import pybullet
import pytest

import ssduck
from ssduck.errors import ArgumentError, UnknownNameError
from tests.support.pasts import ALL

# Of the new body alone, which is at 1 m; the old one was at 5 m. Nothing is what was not there.
ANSWERS = {
    "z(lab.body_0);": 1.0,
    "previous(z(lab.body_0));": 1.0,
    "rate(z(lab.body_0));": 0.0,
    "initially(z(lab.body_0));": None,
    "greatest(z(lab.body_0))[1];": 1.0,
    "heldFor(z(lab.body_0) > 0.5);": pytest.approx(1 / 240),
    "SELECT z(lab.body_0) FROM lab{0.0} AS list;": [None],
    "SELECT z(lab{0.0}.body_0) FROM lab{0.0} AS list;": [5.0],
}


@pytest.mark.slow
def test_it_is_another_entity(tmp_path):
    client = pybullet.connect(pybullet.DIRECT)
    old = pybullet.createMultiBody(1, basePosition=[0, 0, 5], physicsClientId=client)
    with ssduck.Interpreter(recording=ssduck.Recording(tables=ALL)) as ss:
        lab = ss.add_variable("lab", ssduck.World.attach(client))
        for _ in range(3):
            lab.step()
        pybullet.removeBody(old, physicsClientId=client)
        new = pybullet.createMultiBody(1, basePosition=[0, 0, 1], physicsClientId=client)
        assert new == old
        lab.step()
        assert ss.eval("[rate(z(lab.body_0)), previous(z(lab.body_0))];") == [None, None]
        lab.step()
        ss.export(tmp_path / "run")
        with ssduck.open(tmp_path / "run") as opened:
            for one in (ss, opened):
                assert {program: one.eval(program) for program in ANSWERS} == ANSWERS
                with pytest.raises(ArgumentError, match=r"a number and nothing: .* at\(0\.5, z"):
                    one.eval("lifted(lab.body_0, 0.1);")
    pybullet.disconnect(client)


@pytest.mark.slow
def test_a_body_that_came_later_is_told_of(tmp_path):
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.createMultiBody(1, basePosition=[0, 0, 5], physicsClientId=client)
    with ssduck.Interpreter(recording=ssduck.Recording()) as ss:
        lab = ss.add_variable("lab", ssduck.World.attach(client))
        lab.step()
        pybullet.createMultiBody(1, basePosition=[0, 0, 1], physicsClientId=client)
        lab.step()
        ss.export(tmp_path / "run")
        with ssduck.open(tmp_path / "run") as opened:
            for one in (ss, opened):
                for past in ("lab{0.0}.body_1", "lab{0.0}['body_1']"):
                    with pytest.raises(UnknownNameError, match="was not there at 0 s") as caught:
                        one.eval(f"z({past});")
                    advice = caught.value.message.partition(": ")[2].partition(" has")[0]
                    assert one.eval(f"{advice}[1][0];") == lab.time
                with pytest.raises(UnknownNameError, match="only body_0"):
                    one.eval("z(lab{0.0}.cup);")
        assert repr(lab).endswith("; World.attach(…, names=…) names body_0>")
        named = ssduck.World.attach(client, names={0: "cup", 1: "box"})
        assert "names=" not in repr(named)
    pybullet.disconnect(client)
