"""Bodies fly about in a closed box, and queries over the record count how often they collide.

As in SelectScript's demonstration of its dialect for ODE: boxes, spheres, cylinders and capsules
without gravity, which lose no energy. The solver finds a contact in the step after the tick at
which shapes overlap. Finite steps change the energy of long bodies that spin fast.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from PIL import Image, ImageDraw, ImageOps

from ssduck.adapters.charts import INK, WHITE, chart, font
from ssduck.adapters.display import DisplayTable, text_lines
from ssduck.demos.results import Say, keep_picture
from ssduck.geometry.arrays import Array
from ssduck.geometry.poses import rotation_matrices
from ssduck.interpreter.interpreter import Interpreter
from ssduck.recording.spec import Recording
from ssduck.simulators.scenes import Scene, find_scene
from ssduck.world.world import World

Overlap: TypeAlias = tuple[int, int, int]  # a tick, and the ids of two bodies, ascending

# The largest initial velocity along and about each axis, m/s and rad/s.
MAX_SPEED = 2.0
# The largest allowed relative change of the energy.
MAX_ENERGY_CHANGE = 0.15
# Smaller penetrations, m, need not agree: PyBullet rounds the edges of its cylinders.
MIN_DEPTH = 1e-3

# What the camera sees.
VISIBLE = "SELECT id FROM chaos WHERE isSensing(watcher, this) AND mass(this) > 0 AS list;"

# A collision begins if the two were apart at the tick before; -9 is before all ticks.
COUNTED = """\
WITH met AS (
    SELECT DISTINCT c.tick, c.time, c.a, c.b, greatest(a.fixed, b.fixed) AS side
    FROM contacts_history c JOIN (SELECT id, mass = 0 AS fixed FROM entities) a ON a.id = c.a
    JOIN (SELECT id, mass = 0 AS fixed FROM entities) b ON b.id = c.b
), begun AS (
    SELECT *, tick - lag(tick, 1, -9) OVER (PARTITION BY a, b ORDER BY tick) > 1 AS new FROM met
)
SELECT floor(time)::INT AS second, count(*) FILTER (new AND NOT side) AS bodies,
    count(*) FILTER (new AND side) AS sides
FROM begun GROUP BY second ORDER BY second"""

# What overlaps at the ticks of the last second, by its shapes, and by the solver, a tick later.
COLLIDING = """\
SELECT to(tick(a.this), 'tick'), to(environmentID(a.this), 'a'), to(environmentID(b.this), 'b'),
    to(penetration(a.this, b.this), 'depth'), to(time(a.this), 'time')
FROM a=chaos{-1.0}, b=chaos{-1.0}
WHERE collides(a.this, b.this);"""

CONTACTS = """
SELECT tick - 1, a, b, max(depth) FROM contacts_history
WHERE time > $since GROUP BY tick, a, b"""

# How each body moves at the first tick of each second.
MOTION = """
SELECT floor(time)::INT, name, mass, [vx, vy, vz], [wx, wy, wz], [qw, qx, qy, qz]
FROM entities_history
WHERE mass > 0 QUALIFY row_number() OVER (PARTITION BY name, floor(time) ORDER BY tick) = 1
ORDER BY floor(time)"""

# The inner sides are at ±2 m; a contact may be a little deep.
ESCAPED = """\
SELECT id FROM chaos{}
WHERE mass(this) > 0 AND NOT fitsBox(this, [-2.05, -2.05, -2.05], [2.05, 2.05, 2.05]) AS list;"""


def run(folder: Path, say: Say, *, seed: int, seconds: int = 10) -> bool:
    """Simulates the bodies, counts collisions, checks them against the shapes, draws a picture."""
    scene = scene_of(random.Random(seed))  # noqa: S311  # no secret
    visible_counts: list[int] = []
    with Interpreter() as ss:
        chaos = ss.add_variable("chaos", World.load(scene))
        ss.record("chaos", Recording(tables=("entities", "contacts"), seconds=seconds + 1))
        ss.add_variable("watcher", chaos["watcher"])
        ss.add_trigger("seen", VISIBLE, 0.1, lambda names: visible_counts.append(len(names)))
        chaos.run(seconds)
        energies = energy_by_second(ss, scene)
        say(COUNTED)
        rows = [
            (second, bodies, sides, round(energies[second], 1))
            for second, bodies, sides in ss.sql(COUNTED).fetchall()
            if second in energies
        ]
        counts = DisplayTable(["second", "body and body", "body and side", "energy, J"], rows)
        say("\n".join(text_lines(counts)))
        say(
            f"What the camera in the western side sees changed {len(visible_counts) - 1} "
            f"times: {min(visible_counts)} to {max(visible_counts)} bodies at once"
        )
        agree = shapes_agree(ss, say)
        escaped = ss.eval(ESCAPED)
        say(f"Out of the box: {', '.join(escaped) or 'nobody'}")
        drift = max(abs(value / energies[0] - 1) for value in energies.values())
        say(f"The energy is never farther than {drift:.1%} from what it was")
        picture, bars = Image.fromarray(chaos.render(720, 540)), _bars(rows)
        both = ImageOps.expand(picture, (0, 0, 0, bars.height), WHITE)
        both.paste(bars, (0, picture.height))
    say(f"The end, and collisions by second: {keep_picture(both, folder / 'chaos.png')}")
    return agree and not escaped and drift < MAX_ENERGY_CHANGE


def scene_of(rng: random.Random) -> Scene:
    """Returns the scene with random velocities of the bodies."""
    scene = find_scene("chaos")
    bodies = list(scene.bodies)
    for number, body in enumerate(bodies):
        if not body.fixed:
            velocity = tuple(rng.uniform(-MAX_SPEED, MAX_SPEED) for _ in range(6))
            bodies[number] = replace(body, velocity=velocity)
    return replace(scene, bodies=tuple(bodies))


def shapes_agree(ss: Interpreter, say: Say) -> bool:
    """Checks whether shapes and solver find the same pairs in the last second but its last tick."""
    chaos = ss.call_variable("chaos")
    say(COLLIDING)
    shapes = {
        (row["tick"], row["a"], row["b"]): row["depth"]
        for row in ss.eval(COLLIDING)
        if row["a"] < row["b"] and row["time"] < chaos.time
    }
    since = chaos.time - 1.0 + chaos.timestep / 2
    solver = {
        (tick, a, b): depth for tick, a, b, depth in ss.sql(CONTACTS, {"since": since}).fetchall()
    }
    say(
        f"In the last second {len(shapes)} times two overlapped by their shapes; the solver "
        f"found {len(solver)}, {len(shapes.keys() & solver.keys())} of them the same"
    )
    return _are_among(shapes, solver) and _are_among(solver, shapes)


def _are_among(some: Mapping[Overlap, float], others: Mapping[Overlap, float]) -> bool:
    """Checks whether all overlaps that are deep enough are among others, at most a tick apart."""
    return all(
        any((near_tick, a, b) in others for near_tick in (tick - 1, tick, tick + 1))
        for (tick, a, b), depth in some.items()
        if depth > MIN_DEPTH
    )


def energy_by_second(ss: Interpreter, scene: Scene) -> dict[int, float]:
    """Returns the kinetic energy of all bodies at the beginning of each second, J.

    That of a body is (m v·v + I₁ω₁² + I₂ω₂² + I₃ω₃²) / 2, with ω in the body's frame.
    """
    import xml.etree.ElementTree as ET  # reads only files of ssduck

    moments: dict[str, Array] = {}
    for body in scene.bodies:
        element = ET.parse(str(body.model)).find(".//inertia")  # noqa: S314
        assert element is not None
        moments[str(body.name)] = np.array(
            [element.attrib[a] for a in ("ixx", "iyy", "izz")], float
        )
    energies: dict[int, float] = {}
    for second, name, mass, velocity, spin, orientation in ss.sql(MOTION).fetchall():
        local_spin = spin @ rotation_matrices(np.array([orientation]))[0]
        value = (mass * np.dot(velocity, velocity) + moments[name] @ local_spin**2) / 2
        energies[second] = energies.get(second, 0.0) + float(value)
    return energies


# The two kinds of collisions in the chart, with their colours.
_COLLISIONS = {"collisions of two bodies": (230, 120, 30), "of a body with a side": (130, 190, 210)}
# The size of the area of the chart, pixels, and the part of a second that its bar takes.
_CHART, _BAR = (480, 120), 0.7


def _bars(rows: Sequence[tuple[int, int, int, float]]) -> Image.Image:
    """Draws a bar in each second, with the number of each kind above it."""
    seconds = 1 + max((second for second, *_ in rows), default=0)
    # The numbers above the tallest bar have their place, too.
    most = 1.25 * max((bodies + sides for _, bodies, sides, _ in rows), default=1)
    width, height = _CHART
    area = Image.new("RGB", _CHART, WHITE)
    draw, face = ImageDraw.Draw(area), font()
    for second, bodies, sides, _ in rows:
        left, top = width * (second + (1 - _BAR) / 2) / seconds, float(height)
        right = left + _BAR * width / seconds
        for count, colour in zip((bodies, sides), _COLLISIONS.values(), strict=True):
            bottom, top = top, top - height * count / most
            if count:
                draw.rectangle((left, top, right, bottom), fill=colour)
        middle = (left + right) / 2
        draw.text((middle, top - 2), f"{bodies} + {sides}", fill=INK, font=face, anchor="mb")
    entries = [(colour, name) for name, colour in _COLLISIONS.items()]
    return chart(
        area, ((0, 0), (seconds, most)), ("time [s]", "collisions in 1 s"), entries=entries
    )
