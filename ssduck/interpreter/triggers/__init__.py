"""Triggers evaluate programs as simulated time passes, and call back when results change.

`registry` holds the triggers of an interpreter, and `trigger` is one of them, with the thread of
its callback. `conditions` compares results, and decides when it fires.

Triggers that are due at the same tick are evaluated together (`tick_batch`) if their programs are
formulas over the entities of a world (`formulas`): those that differ in constants alone are one
expression over arrays (`ssduck.columns`), which asks for shapes of live ticks (`shapes`).
"""
