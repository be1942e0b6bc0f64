"""A forked process leaves its parent's databases alone, also if Python frees them there."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="it forks")

# What a user dropped without closing it is garbage that the child collects, as the workers of
# `AsyncVectorEnv` do at any time.
SCRIPT = """
import gc, os, sys
import mujoco
import ssduck

gc.disable()
xml = '<mujoco><worldbody><body name="b"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
model = mujoco.MjModel.from_xml_string(xml)
for path in sys.argv[1:]:
    ss = ssduck.Interpreter(path)
    world = ss.add_variable("lab", ssduck.World.attach(model, mujoco.MjData(model)))
    for _ in range(5):
        world.tick()
    ss.eval("SELECT id FROM lab WHERE z(this) < 1;")
    ss.eval("heldFor(z(lab.b) < 1);")
    ss.itself = ss
del ss, world
child = os.fork()
if not child:
    gc.enable()
    print("collected", gc.collect() > 0, flush=True)
    os._exit(0)
print("status", os.waitpid(child, 0)[1], flush=True)
gc.collect()
"""


@pytest.mark.long
def test_a_child_frees_no_database_of_its_parent(tmp_path):
    files = [":memory:", str(tmp_path / "run.duckdb"), ":memory:"]
    command = [sys.executable, "-W", "ignore", "-c", SCRIPT, *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["collected True", "status 0"]
