"""Finds the first touch in a record, and how hard it was.

`python examples/first_touch.py [RECORD [A B]]` opens a record without a simulator, and asks when
its entities A and B first touched. Without a record it makes one, `dropped`: a can that is dropped
over the kitchen's table. It prints the first touch, the hardest push, and how long they touched.
"""

from __future__ import annotations

import sys
from pathlib import Path

import ssduck


def drop_a_can(folder: str) -> None:
    """Records a second and a half of the kitchen, in which its can is dropped over the table."""
    with ssduck.load("kitchen") as ss:
        kitchen = ss["kitchen"]
        with ss.record_to(folder, recording=ssduck.Recording(tables=("links", "contacts"))):
            kitchen["can"].move([0.42, -0.1, 1.1])
            kitchen.run(1.5)


def main(record: str = "dropped", a: str = "can", b: str = "table") -> None:
    """Tells of the touches of two entities in a record."""
    if record == "dropped" and not Path(record).exists():
        drop_a_can(record)
    with ssduck.open(record) as ss:
        (world,) = ss.worlds
        ss["a"], ss["b"] = world[a], world[b]  # a wrong name is an error with the nearest right one
        touches = ss.eval("holds(inContact(a, b));")
        if not touches:
            print(f"{a} and {b} never touched")
            return
        time, force = ss.eval("greatest(contactForce(a, b));")
        print(f"{a} and {b} first touched at {touches[0][0]:.4f} s")
        print(f"hardest at {time:.4f} s, with {force:.2f} N")
        print(f"{len(touches)} touches, {sum(end - begin for begin, end in touches):.4f} s in all")


if __name__ == "__main__":
    main(*sys.argv[1:])
